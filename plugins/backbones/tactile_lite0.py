"""The trunk for real touch: the first block of a tactile trunk, and EfficientNet-Lite0 with ImageNet weights.

Small edges of real gels are seen better by few layers, and by features that were not learnt from simulated presses
alone; docs/backbone.md compares. Its facts name the two parts by their hashes.

Refs: plugins/backbones/tactile.py, plugins/backbones/efficientnet_lite0.py.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from edge.core.errors import ConfigError
from plugins.backbones.resnet import TAPS
from plugins.backbones.tactile import read_file

__all__ = ["TactileLite0", "tactile_lite0"]


@dataclass(frozen=True)
class TactileLite0:
    """A backbone under the entry points `gelgate.backbones`. Each part normalises the colours as it was trained."""

    name: str = "tactile_lite0"

    def facts(self) -> dict[str, object]:
        """Give what a manifest records with the trunk's SHA-256."""
        known = json.loads(read_file(f"{self.name}.json"))
        return {
            "topology": self.name,
            "weights": "the first block of a tactile resnet18, and EfficientNet-Lite0 learnt from ImageNet photographs",
            "weights_sha256": known["made_of"]["efficientnet_lite0"],
            "licence": known["licence"],
        }

    def trunk(self, taps: Sequence[str] = TAPS) -> bytes:
        """The serialised trunk; it always gives layer1, layer2 and layer3. Errors: ConfigError for another tap."""
        missing = [tap for tap in taps if tap not in TAPS]
        if missing or not taps:
            raise ConfigError(
                f"the backbone {self.name} gives {', '.join(TAPS)}, requested were {', '.join(missing) or 'nothing'}; "
                "choose among them, or another backbone"
            )
        return read_file(f"{self.name}.onnx")


tactile_lite0 = TactileLite0()
