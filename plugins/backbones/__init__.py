"""Backbones: weights in torchvision's naming become trunks, ONNX graphs from frames to named feature maps."""
