"""torchvision beside torch for the CPU, imported before anomalib is.

torchvision's wheels are built for torch with CUDA; beside torch for the CPU its compiled operators do not load, and its
import then asks for these two, which nothing here calls.
"""

import sys

import torch

try:
    import torchvision.io  # noqa: F401
except RuntimeError:
    for _name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
        del sys.modules[_name]
    _library = torch.library.Library("torchvision", "DEF")
    for _operator in ("nms", "qnms"):
        _library.define(f"{_operator}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
