"""Training of the tactile backbone: a ResNet-18 trunk trained on simulated presses.

`train_config` has every setting; `training_pairs` draws presses of random parts with the simulator; `losses` is the
objective; `train` is the loop; `package` makes the shipped graphs. Only these modules import torch, and they are
imported at use: what the shipped weights' facts need does without it.
"""
