"""The trunk for real touch: the first block of a tactile trunk, and EfficientNet-Lite0 with ImageNet weights.

Small edges of real gels are seen better by few layers, and by features that were not learnt from simulated presses
alone; docs/backbone.md compares. Its facts name the two parts by their hashes.

Refs: plugins/backbones/tactile.py, plugins/backbones/efficientnet_lite0.py.
"""

import json
from functools import partial

from plugins.backbones.tactile import FixedTrunk, read_file

__all__ = ["tactile_lite0"]


def _facts() -> dict[str, object]:
    """Each part normalises the colours as it was trained."""
    known = json.loads(read_file("tactile_lite0.json"))
    return {
        "topology": "tactile_lite0",
        "weights": "the first block of a tactile resnet18, and EfficientNet-Lite0 learnt from ImageNet photographs",
        "weights_sha256": known["made_of"]["efficientnet_lite0"],
        "licence": known["licence"],
    }


tactile_lite0 = FixedTrunk("tactile_lite0", _facts, partial(read_file, "tactile_lite0.onnx"))
