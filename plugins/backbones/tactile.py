"""The shipped tactile backbone: a ResNet-18 up to layer3, trained by this project on simulated presses.

The graphs and their facts are in this folder; docs/backbone.md is the model card.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources

from edge.core.errors import ConfigError
from plugins.backbones.input_steps import IMAGENET
from plugins.backbones.resnet import TAPS

__all__ = ["FixedTrunk", "read_file", "tactile_resnet18", "tactile_resnet18_int8"]


@cache
def read_file(file: str) -> bytes:
    """A file of this folder. Errors: ConfigError when the installation lacks it."""
    try:
        return resources.files("plugins.backbones").joinpath(file).read_bytes()
    except OSError as error:
        raise ConfigError(
            f"the backbone's file '{file}' is missing from this installation ({error.strerror}); install gelgate again"
        ) from error


@dataclass(frozen=True)
class FixedTrunk:
    """A backbone under the entry points `gelgate.backbones`, whose trunk always gives layer1, layer2 and layer3."""

    name: str
    """The name of the variant, as in the facts."""
    read_facts: Callable[[], dict[str, object]]
    read_trunk: Callable[[], bytes]

    def facts(self) -> dict[str, object]:
        return self.read_facts()

    def trunk(self, taps: Sequence[str] = TAPS) -> bytes:
        """The serialised trunk. Errors: ConfigError for another tap, or a trunk that cannot be read."""
        missing = [tap for tap in taps if tap not in TAPS]
        if missing or not taps:
            raise ConfigError(
                f"the backbone {self.name} gives {', '.join(TAPS)}, requested were {', '.join(missing) or 'nothing'}; "
                "choose among them, or another backbone"
            )
        return self.read_trunk()


def _facts() -> dict[str, object]:
    known = json.loads(read_file("tactile_resnet18.json"))
    recipe = known["recipe"]
    return {
        "topology": "resnet18",
        "weights": (
            f"trained on simulated presses: {known['trained_steps']} steps, {known['pairs_seen']} pairs of "
            f"{recipe['side']}x{recipe['side']} frames, seed {recipe['seed']}"
        ),
        "mean": list(IMAGENET.mean),
        "std": list(IMAGENET.std),
        "licence": "Apache-2.0",
    }


tactile_resnet18, tactile_resnet18_int8 = (
    FixedTrunk(name, _facts, partial(read_file, f"{name}.onnx"))
    for name in ("tactile_resnet18", "tactile_resnet18_int8")
)
