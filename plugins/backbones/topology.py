"""The ResNet family as data: which convolutions a network has, and what torchvision calls them.

Ref: torchvision.models.resnet (v1.5 bottleneck: the stride sits in the 3x3 convolution), re-stated from its state dict.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError

__all__ = [
    "TOPOLOGIES",
    "Block",
    "Conv",
    "State",
    "Topology",
    "check_state",
    "last_block",
    "list_shapes",
    "list_taps",
    "recognised",
    "refuse_faults",
    "refuse_infinite",
    "topology",
]

State = Mapping[str, NDArray[np.floating]]
"""Weights by torchvision's names, such as `layer1.0.conv1.weight`."""

STAGES = ("layer1", "layer2", "layer3", "layer4")


@dataclass(frozen=True)
class Conv:
    """One convolution and the batch norm that follows it, by their names in the state."""

    name: str
    norm: str
    inputs: int
    outputs: int
    kernel: int
    stride: int

    @property
    def padding(self) -> int:
        return self.kernel // 2


@dataclass(frozen=True)
class Block:
    """A residual block: convolutions in order (ReLU between), plus the input, adapted by `shortcut` if there is one."""

    name: str
    convs: tuple[Conv, ...]
    shortcut: Conv | None


@dataclass(frozen=True)
class Topology:
    """One member of the family."""

    name: str
    kind: Literal["basic", "bottleneck"]
    depths: tuple[int, int, int, int]
    width: int = 64
    """Channels of the 3x3 convolutions at layer1."""
    stem: Conv = field(default=Conv("conv1", "bn1", 3, 64, 7, 2))

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All residual blocks, first to last."""
        return tuple(self._blocks())

    def channels(self, stage: int) -> int:
        """Channels of a stage's output, stage 0 to 3."""
        return (64, 128, 256, 512)[stage] * (1 if self.kind == "basic" else 4)

    def _blocks(self) -> Iterator[Block]:
        inputs = 64
        for stage, depth in enumerate(self.depths):
            inner, outputs = self.width * 2**stage, self.channels(stage)
            for index in range(depth):
                stride = 2 if stage > 0 and index == 0 else 1
                name = f"{STAGES[stage]}.{index}"
                adapted = stride != 1 or inputs != outputs
                shortcut = Conv(f"{name}.downsample.0", f"{name}.downsample.1", inputs, outputs, 1, stride)
                yield Block(
                    name, self._convs(name, inputs, inner, outputs, stride), shortcut if adapted else None
                )
                inputs = outputs

    def _convs(self, name: str, inputs: int, inner: int, outputs: int, stride: int) -> tuple[Conv, ...]:
        def conv(index: int, a: int, b: int, kernel: int, step: int) -> Conv:
            return Conv(f"{name}.conv{index}", f"{name}.bn{index}", a, b, kernel, step)

        if self.kind == "basic":
            return conv(1, inputs, outputs, 3, stride), conv(2, outputs, outputs, 3, 1)
        return conv(1, inputs, inner, 1, 1), conv(2, inner, inner, 3, stride), conv(3, inner, outputs, 1, 1)


TOPOLOGIES: Mapping[str, Topology] = {
    each.name: each
    for each in (
        Topology("resnet18", "basic", (2, 2, 2, 2)),
        Topology("resnet50", "bottleneck", (3, 4, 6, 3)),
        Topology("wide_resnet50_2", "bottleneck", (3, 4, 6, 3), width=128),
    )
}


def topology(name: str) -> Topology:
    """A topology by name. Errors: ConfigError naming those that are known."""
    if name not in TOPOLOGIES:
        raise ConfigError(f"no topology is named '{name}'; known: {', '.join(TOPOLOGIES)}")
    return TOPOLOGIES[name]


def list_taps(net: Topology) -> tuple[str, ...]:
    """List the taps of a network in order of computation; a stage is the same tensor as its last block."""
    taps = ["relu", "maxpool"]
    for stage, depth in zip(STAGES, net.depths, strict=True):
        taps += [f"{stage}.{index}" for index in range(depth)] + [stage]
    return (*taps, "avgpool")


def last_block(net: Topology, tap: str) -> str:
    """The block whose output a tap is: `layer2` is `layer2.3`. Errors: ConfigError for an unknown tap."""
    if tap not in list_taps(net):
        raise ConfigError(f"{net.name} has no tap '{tap}'; known: {', '.join(list_taps(net))}")
    if tap in STAGES:
        return f"{tap}.{net.depths[STAGES.index(tap)] - 1}"
    return tap


def list_shapes(net: Topology, until: Iterable[str] = ("avgpool",)) -> dict[str, tuple[int, ...]]:
    """Map each weight that these taps need to its shape (never the classifier `fc` or the batch counters)."""
    shapes: dict[str, tuple[int, ...]] = {}
    convs = [net.stem]
    left = {last_block(net, tap) for tap in until} - {"relu", "maxpool"}
    for block in net.blocks:
        if not left:
            break
        convs += [*block.convs, *([block.shortcut] if block.shortcut else [])]
        left.discard(block.name)
    for conv in convs:
        shapes[f"{conv.name}.weight"] = (conv.outputs, conv.inputs, conv.kernel, conv.kernel)
        for part in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{conv.norm}.{part}"] = (conv.outputs,)
    return shapes


def recognised(state: State) -> Topology | None:
    """The network whose weights these are, as far as they go; None where none has all of them in these shapes."""
    weights = {key: tuple(value.shape) for key, value in state.items() if not _ignored(key)}
    nets = (net for net in TOPOLOGIES.values() if weights.items() <= list_shapes(net).items())
    return next(nets, None) if weights else None


def check_state(
    state: State, net: Topology, name: str = "the weights", until: Iterable[str] = ("avgpool",)
) -> None:
    """Refuse weights that are not this network's, or lack what the taps in `until` need.

    Errors: ConfigError with the missing, unexpected and wrongly shaped names (a few of each), or the weights that
    are not finite.
    """
    shapes = list_shapes(net)
    extra = [key for key in state if key not in shapes and not _ignored(key)]
    missing = [key for key in list_shapes(net, until) if key not in state]
    refuse_faults(state, shapes, missing, extra, f"{name} are not a {net.name} in torchvision's naming: ")
    refuse_infinite(state, shapes, name)


def refuse_faults(
    state: State,
    shapes: Mapping[str, tuple[int, ...]],
    missing: Sequence[str],
    extra: Sequence[str],
    start: str,
    end: str = "",
) -> None:
    """Refuse missing, unexpected and wrongly shaped weights, a few of each by name. Errors: ConfigError."""
    wrong = [
        f"{key} {tuple(state[key].shape)} instead of {shape}"
        for key, shape in shapes.items()
        if key in state and tuple(state[key].shape) != shape
    ]
    faults = [
        f"{len(names)} {what} ({', '.join(names[:4])}{', ...' if len(names) > 4 else ''})"
        for what, names in (("missing", missing), ("unexpected", extra), ("wrongly shaped", wrong))
        if names
    ]
    if faults:
        raise ConfigError(f"{start}{'; '.join(faults)}{end}")


def refuse_infinite(state: State, names: Iterable[str], where: str) -> None:
    """Refuse weights that are not finite. Errors: ConfigError with a few of their names."""
    bad = [key for key in names if key in state and not np.isfinite(state[key]).all()]
    if bad:
        raise ConfigError(
            f"{where} hold values that are not finite, in {', '.join(bad[:4])}; export another checkpoint"
        )


def _ignored(key: str) -> bool:
    return key.startswith("fc.") or key.endswith(".num_batches_tracked")
