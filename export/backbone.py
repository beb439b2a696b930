"""`export backbone`: weights of a ResNet or a vision transformer, or an ONNX network, become a trunk.

Before anything is written, the trunk is compared with a NumPy reference of the same network (or with the ONNX network
itself) at its input and at every tap. The licence of the weights is in the trunk's metadata, and so in every bundle
that is fitted on it.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, U8
from edge.core.errors import ConfigError
from edge.model.bundle_writer import write_file
from edge.model.manifest_facts import LICENCE
from export.graph_file import read_graph
from export.known_weights import Encoder, check_release, encoder, stated_licence
from export.onnx_trunk import graph_trunk, name_taps
from export.onnx_values import first_conv_input, run_values
from export.parity import ParityReport, Stage, compare
from export.weights_file import file_sha256, is_onnx, read_checkpoint, read_weights
from plugins.backbones.input_steps import IMAGENET, InputSteps, apply_steps
from plugins.backbones.reference import forward
from plugins.backbones.resnet import TAPS, build_trunk
from plugins.backbones.topology import (
    TOPOLOGIES,
    State,
    Topology,
    check_state,
    list_shapes,
    recognised,
    topology,
)
from plugins.backbones.vit import list_vit_taps, vit_shape
from plugins.backbones.vit_reference import vit_forward
from plugins.backbones.vit_trunk import build_vit_trunk

__all__ = ["BackboneExport", "BackboneOptions", "export_backbone", "read_checkpoint", "weights_sha256"]

PATCHES = "patch_embed.proj.weight"

HALF_TOLERANCE = 5e-3
"""Allowed difference of a trunk whose weights are stored as float16, in place of the usual one (measured: 3e-4)."""


@dataclass(frozen=True)
class BackboneOptions:
    """How a file becomes a trunk."""

    licence: str | None
    """The licence of the weights; required."""
    topology: str | None = None
    """The kind of a ResNet, None for the one that the weights have; ViTs and ONNX graphs need none."""
    taps: tuple[str, ...] = ()
    """The taps, see `export backbone --help`; empty: the usual ones."""
    encoder: str | None = None
    """A published touch encoder whose preprocessing is used."""
    steps: InputSteps | None = None
    """The preprocessing instead of the encoder's, or of ImageNet's."""
    background: U8 | None = None
    frame: tuple[int, int] = (224, 224)
    """(h, w) of the inspected region."""
    weights: Literal["float32", "float16"] = "float32"
    version: str | None = None
    """V1 or V2 where the caller states it."""
    second: Path | None = None
    """A file whose blocks follow."""
    prefix: str | None = None
    """The beginning of the weights' names, where a file holds several networks."""
    heads: int | None = None
    """The number of the attention's heads."""
    prefix_tokens: int | None = None
    """Tokens of an ONNX graph to drop; see `graph_trunk`."""
    high: float = 1.0
    """The brightest level of an ONNX graph; see `graph_trunk`."""


@dataclass(frozen=True)
class BackboneExport:
    """A trunk that agrees with its reference."""

    trunk: bytes
    taps: tuple[str, ...]
    facts: dict[str, str]
    """The facts that stand in its metadata."""
    parity: ParityReport
    """The comparison."""

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.trunk).hexdigest()


def export_backbone(
    source: Path, output: Path | None, options: BackboneOptions, report: Path | None = None
) -> BackboneExport:
    """Make the trunk of a `.pth`, `.safetensors` or `.onnx` file and write it, completely or not at all.

    output: None writes no trunk. report: a folder for the comparison, which is written also where it fails. Errors:
    ConfigError for a file that is not what the options say or a licence that is not stated, BundleCorrupt where the
    trunk differs from its reference, OSError of the disk.
    """
    known = encoder(options.encoder) if options.encoder else None
    licence = stated_licence(options.licence, f"the weights in {source}", known.licence if known else None)
    if not source.is_file():
        raise ConfigError(
            f"checkpoint {source} does not exist; give the path of a .pth, .safetensors or .onnx file"
        )
    facts = {"weights": source.name, "file_sha256": file_sha256(source), LICENCE: licence}
    if known:
        facts["encoder"] = f"{known.name} ({known.source})"
    steps = _steps(options, known)
    made = _from_graph if is_onnx(source) else _from_weights
    export = made(source, options, steps, facts)
    if report is not None:
        export.parity.write(report)
    export.parity.raise_if_different()
    if output is not None:
        write_file(output, export.trunk)
    return export


def weights_sha256(state: State, topology_name: str) -> str:
    """SHA-256 over the weights that the topology uses, sorted by name: the same for every file that holds them."""
    return _sha256_of(state, sorted(list_shapes(topology(topology_name))))


def _sha256_of(state: State, names: Sequence[str]) -> str:
    digest = hashlib.sha256()
    for name in names:
        digest.update(name.encode() + b"\0")
        digest.update(np.ascontiguousarray(state[name], "<f4").tobytes())
    return digest.hexdigest()


def _steps(options: BackboneOptions, known: Encoder | None) -> InputSteps:
    steps = options.steps or (known.steps if known else IMAGENET)
    if steps is None:
        assert known is not None
        raise ConfigError(
            f"the encoder {known.name} has another mean and std for every sensor; pass those of the data it was "
            f"trained on with --mean and --std ({known.source})"
        )
    if known and known.needs_background and options.background is None:
        raise ConfigError(
            f"the encoder {known.name} reads differences from the untouched gel; pass a picture of it with --background"
        )
    return steps if options.background is None else replace(steps, background=options.background)


def _from_graph(
    source: Path, options: BackboneOptions, steps: InputSteps, facts: dict[str, str]
) -> BackboneExport:
    taps = name_taps(options.taps)
    trunk, facts, stages = graph_trunk(
        read_graph(source),
        taps,
        steps,
        _probe(options.frame),
        high=options.high,
        prefixes=options.prefix_tokens,
        facts=facts,
        where=str(source),
    )
    return BackboneExport(trunk, tuple(taps), facts, _compare(stages, source, facts))


def _from_weights(
    source: Path, options: BackboneOptions, steps: InputSteps, facts: dict[str, str]
) -> BackboneExport:
    state = _select(read_weights(source), options.prefix, source)
    if options.second is not None:
        state = _append_blocks(state, read_weights(options.second), options.second)
    network = _vit if PATCHES in state else _resnet
    return network(state, source, options, steps, facts)


def _resnet(
    state: State, source: Path, options: BackboneOptions, steps: InputSteps, facts: dict[str, str]
) -> BackboneExport:
    net = _topology(state, options.topology, source)
    version = check_release(facts["file_sha256"], options.version, net.name, str(source))
    check_state(state, net, f"the weights in {source}", until=options.taps or TAPS)
    digest = _sha256_of(state, [name for name in sorted(list_shapes(net)) if name in state])
    facts = {**facts, "release": version, "weights_sha256": digest}
    taps = options.taps or TAPS
    is_free = steps.size is None and steps.background is None
    frame = None if is_free else options.frame
    trunk = build_trunk(state, net.name, taps, steps=steps, frame=frame, weights=options.weights, facts=facts)
    # Three steps of stride 32 show every kind of border; a larger frame shows nothing more.
    frames = _probe(frame or (96, 96))
    planes = apply_steps(steps, frames)
    expected = forward(state, net.name, planes.astype(np.float32), taps)
    return _compare_taps(trunk, taps, planes, expected, frames, source, facts, options.weights)


def _topology(state: State, stated: str | None, source: Path) -> Topology:
    """The ResNet whose weights these are. Errors: ConfigError where another one is stated, or none is known."""
    known = recognised(state)
    if stated is not None:
        if known is not None and known.name != topology(stated).name:
            raise ConfigError(
                f"the weights in {source} are of a {known.name}, not a {stated}: --topology {known.name}"
            )
        return topology(stated)
    if known is None:
        raise ConfigError(
            f"the weights in {source} ({len(state)} names, such as {', '.join(sorted(state)[:3])}) are not of a "
            f"{', '.join(TOPOLOGIES)} or a vision transformer; write the network with torch.onnx.export and name taps: "
            "gelgate export backbone NETWORK.onnx --taps NAME,NAME"
        )
    return known


def _vit(
    state: State, source: Path, options: BackboneOptions, steps: InputSteps, facts: dict[str, str]
) -> BackboneExport:
    eps = encoder(options.encoder).eps if options.encoder else 1e-6
    shape = vit_shape(state, f"the weights in {source}", options.heads, eps)
    last = [tap for tap in list_vit_taps(shape) if tap != "norm"]
    taps = options.taps or (last[len(last) // 2 - 1], last[-1])
    facts = {**facts, "weights_sha256": _sha256_of(state, sorted(state))}
    trunk = build_vit_trunk(state, shape, taps, steps, options.frame, weights=options.weights, facts=facts)
    frames = _probe(options.frame)
    planes = apply_steps(steps, frames)
    return _compare_taps(
        trunk, taps, planes, vit_forward(state, shape, planes, taps), frames, source, facts, options.weights
    )


def _compare_taps(
    trunk: bytes,
    taps: Sequence[str],
    planes: F64,
    expected: Mapping[str, NDArray[np.floating]],
    frames: U8,
    source: Path,
    facts: dict[str, str],
    weights: str,
) -> BackboneExport:
    values = run_values(trunk, [first_conv_input(trunk), *taps], {"frames": frames}, "the trunk")
    tolerance = None if weights == "float32" else HALF_TOLERANCE
    stages = [Stage("input", planes, values[0], "input")]
    stages += [
        Stage(tap, expected[tap], f, tolerance=tolerance) for tap, f in zip(taps, values[1:], strict=True)
    ]
    return BackboneExport(trunk, tuple(taps), facts, _compare(stages, source, facts))


def _compare(stages: Sequence[Stage], source: Path, facts: dict[str, str]) -> ParityReport:
    return compare(stages, title=f"Trunk of {source.name}", facts=facts)


def _probe(frame: tuple[int, int]) -> U8:
    """Two frames, uint8 (2, h, w, 3): noise, and slopes with noise; every level and every channel differs."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (2, *frame, 3))
    rows, columns = np.indices(frame)
    slope = np.stack([255 * rows / frame[0], 255 * columns / frame[1], 255 - 255 * rows / frame[0]], axis=2)
    return np.stack([noise[0], 0.7 * slope + 0.3 * noise[1]]).astype(np.uint8)


def _select(state: State, prefix: str | None, source: Path) -> State:
    """The weights of one network, without the prefix of their names. Errors: ConfigError where there are several."""
    if prefix is None:
        ends = (PATCHES, "layer1.0.conv1.weight")
        prefixes = sorted({key.removesuffix(end) for key in state for end in ends if key.endswith(end)})
        if len(prefixes) > 1:
            raise ConfigError(
                f"{source} holds several networks, under {', '.join(prefixes)}; choose one with --prefix, after "
                "self-supervised training the teacher's"
            )
        prefix = prefixes[0] if prefixes else ""
    chosen = {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
    if not chosen:
        names = ", ".join(sorted({key.partition(".")[0] for key in state})[:6])
        raise ConfigError(f"{source} has no weights under '{prefix}'; its names begin with {names}")
    return chosen


def _append_blocks(state: State, second: State, file: Path) -> State:
    """The first network with the blocks of the second after its own, as T3 stores encoder and trunk."""
    numbers = [int(key.split(".")[1]) for key in state if key.startswith("blocks.")]
    first = 1 + max(numbers, default=-1)
    added = {}
    for key, value in second.items():
        parts = key.split(".")
        if parts[0] == "blocks" and len(parts) > 2 and parts[1].isdigit():
            key = ".".join(["blocks", str(first + int(parts[1])), *parts[2:]])
        added[key] = value
    if first == 0 or not any(key.startswith("blocks.") for key in added):
        raise ConfigError(f"{file} does not continue a transformer: both files must hold blocks.<number>.")
    return {**state, **added}
