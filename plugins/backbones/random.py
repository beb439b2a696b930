"""Seeded random weights, for comparison with trained ones and for tests of topologies.

A random ResNet whose batch norms fit its inputs separates edges and textures, so a detector can use it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from plugins.backbones.input_steps import IMAGENET
from plugins.backbones.reference import forward
from plugins.backbones.resnet import NORM_EPS, TAPS, build_trunk
from plugins.backbones.topology import Conv, State, list_shapes, topology

__all__ = ["RandomBackbone", "random_state", "wide_resnet50_2_random"]

# Decimals of the statistics: sums differ in their last bits between machines, weights should not.
DECIMALS = 2


@dataclass(frozen=True)
class RandomBackbone:
    """A backbone under the entry points `gelgate.backbones`, with random weights, as its name and facts say.

    Trained ones come from the user: `gelgate export backbone CHECKPOINT -o trunk.onnx`, then `--backbone trunk.onnx`.
    """

    name: str
    topology: str
    seed: int = 0

    def facts(self) -> dict[str, object]:
        return {
            "topology": self.topology,
            "weights": f"random weights, seed {self.seed}",
            "mean": list(IMAGENET.mean),
            "std": list(IMAGENET.std),
        }

    def trunk(self, taps: Sequence[str] = TAPS) -> bytes:
        """The serialised trunk with these taps of the topology. Errors: ConfigError for another tap."""
        return _trunk(self.topology, tuple(taps), self.seed)


# The seed paper's network; its ImageNet weights are not part of the product.
wide_resnet50_2_random = RandomBackbone("wide_resnet50_2_random", "wide_resnet50_2")


@cache
def _trunk(topology_name: str, taps: tuple[str, ...], seed: int) -> bytes:
    return build_trunk(random_state(topology_name, seed), topology_name, taps)


def random_state(topology_name: str, seed: int = 0) -> State:
    """Weights in torchvision's naming, float32: He-initialised, batch norms fitted to smooth random pictures.

    So every channel before its ReLU has about mean 0 and variance 1, through all depths. Errors: ConfigError.
    """
    rng = np.random.default_rng(seed)
    state: dict[str, F32] = {}
    for name, shape in list_shapes(topology(topology_name)).items():
        if len(shape) == 4:
            fan_in = shape[1] * shape[2] * shape[3]
            state[name] = rng.normal(0, np.sqrt(2 / fan_in), shape).astype(np.float32)
        else:
            state[name] = np.full(shape, name.endswith((".weight", "_var")), np.float32)

    def fit_norm(conv: Conv, x: NDArray[np.floating]) -> NDArray[np.floating]:
        mean, var = x.mean(axis=(0, 2, 3)).round(DECIMALS), x.var(axis=(0, 2, 3)).round(DECIMALS)
        # A channel that is almost constant on these pictures must not be amplified a hundredfold on others.
        var = np.maximum(var, max(0.1 * float(var.mean()), 10.0**-DECIMALS)).round(DECIMALS)
        state[f"{conv.norm}.running_mean"] = mean.astype(np.float32)
        state[f"{conv.norm}.running_var"] = var.astype(np.float32)
        scaled: NDArray[np.floating] = (x - mean[:, None, None]) / np.sqrt(var[:, None, None] + NORM_EPS)
        return scaled

    # In float64: the rounding of float32 differs between two runs, and moves a mean across a rounded decimal.
    forward(state, topology_name, _smooth_pictures(rng).astype(np.float64), ("avgpool",), fit_norm)
    return state


def _smooth_pictures(rng: np.random.Generator) -> F32:
    """Normalised planes float32 (4, 3, 64, 64): noise at three scales, as lit relief has."""
    planes = np.zeros((4, 3, 64, 64))
    for size in (4, 16, 64):
        noise = rng.normal(size=(4, 3, size, size))
        planes += np.kron(noise, np.ones((64 // size, 64 // size))) / np.sqrt(3)
    return planes.astype(np.float32)
