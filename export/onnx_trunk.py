"""Any ONNX network with named taps becomes a trunk: frames in, feature maps out, nothing after the last tap.

A tap is a value inside the graph, `NAME=VALUE` or the value's own name. A map (n, c, h, w) stays as it is; a sequence
of tokens (n, l, c) loses its prefix tokens and becomes the patch grid (n, c, rows, columns).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import U8
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion
from edge.model.graph_cut import prune
from export.onnx_values import PIXELS, append, load_model, picture_input, read_frames, run_each
from export.parity import Stage
from plugins.backbones.input_steps import InputSteps
from plugins.onnx_builder import Graph

__all__ = ["graph_trunk", "name_taps"]

MOST_PREFIXES = 8
"""Class, distillation and register tokens together: DINOv2 with registers has five."""


def name_taps(taps: Sequence[str]) -> dict[str, str]:
    """`layer1=/blocks.3/Add_1_output_0` or a value's own name, to a name for each value. Errors: ConfigError."""
    pairs = [tap.partition("=")[::2] for tap in taps]
    named = {name.strip(): (value or name).strip() for name, value in pairs}
    if not taps or len(named) < len(taps) or not all(named) or not all(named.values()):
        raise ConfigError(
            f"taps are distinct values of the graph, such as layer1=/blocks.3/Add_1_output_0; found "
            f"{', '.join(taps) or 'none'}"
        )
    return named


def graph_trunk(
    data: bytes,
    taps: Mapping[str, str],
    steps: InputSteps,
    frames: U8,
    *,
    high: float,
    prefixes: int | None,
    facts: Mapping[str, str],
    where: str,
) -> tuple[bytes, dict[str, str], list[Stage]]:
    """Make the trunk and its metadata, and compute its stages and the foreign graph's on `frames`, uint8 (n, h, w, 3).

    high: what the brightest level is in the graph's input after the steps. prefixes: tokens to drop from sequences;
    None: as many as leave a square grid, at most eight. Errors: ConfigError for a graph without this picture input or
    these values, or values that are no feature maps.
    """
    from onnx.helper import set_model_props

    model = load_model(data, where)
    _check_values(model, taps, where)
    picture = picture_input(model, where)
    frame = (frames.shape[1], frames.shape[2])
    if picture.size is not None and picture.size != (steps.size or frame):
        steps = replace(steps, size=picture.size)
    facts = {**facts, "preprocessing": steps.words}
    pixels = picture.prepare(frames, steps, high)
    expected = run_each(data, list(taps.values()), picture.name, pixels, picture.batch, where)
    grids = {tap: _grid(array, tap, prefixes) for tap, array in zip(taps, expected, strict=True)}
    body = read_frames(model, picture, steps, frame, high)
    merged = append(body, _end(taps, expected, grids), {v: f"value_{tap}" for tap, v in taps.items()})
    prune(merged)
    set_model_props(merged, facts)
    trunk = bytes(merged.SerializeToString())
    front = f"front/{PIXELS}"
    arrays = run_each(trunk, [front, *taps], "frames", frames, picture.batch, where)
    stages = [
        Stage(tap, _as_maps(array, *grids[tap]), found)
        for tap, array, found in zip(taps, expected, arrays[1:], strict=True)
    ]
    return trunk, facts, [Stage("input", pixels, arrays[0], "input"), *stages]


def _check_values(model: Any, taps: Mapping[str, str], where: str) -> None:
    known: list[str] = []
    seen = {value.name for value in model.graph.input} - {tensor.name for tensor in model.graph.initializer}
    for node in model.graph.node:  # in the order of computation; what depends on no input is a weight
        if seen.intersection(node.input):
            seen.update(node.output)
            known += [name for name in node.output if name]
    for tap, value in taps.items():
        if value not in known:
            raise ConfigError(
                f"{where} has no value '{value}' for the tap '{tap}'; {suggestion(value, known)} (of {len(known)}; "
                "netron.app shows them all)"
            )


def _grid(array: NDArray[Any], tap: str, prefixes: int | None) -> tuple[int, int, int]:
    """(rows, columns, prefix tokens) of a tap's values; rows 0 for a map. Errors: ConfigError."""
    if array.dtype not in (np.float32, np.float16) or array.ndim not in (3, 4):
        raise ConfigError(
            f"the tap '{tap}' is {array.dtype} {array.shape}; expected are a map (n, c, h, w) or tokens (n, l, c) of "
            "floats"
        )
    if array.ndim == 4:
        return 0, 0, 0
    for dropped in range(MOST_PREFIXES + 1) if prefixes is None else (prefixes,):
        side = round(max(array.shape[1] - dropped, 0) ** 0.5)
        if side > 0 and side * side == array.shape[1] - dropped:
            return side, side, dropped
    raise ConfigError(
        f"the tap '{tap}' has {array.shape[1]} tokens, and no square grid is left when prefix tokens are dropped; "
        "state them with --prefix-tokens, and use a square region"
    )


def _as_maps(array: NDArray[Any], rows: int, columns: int, dropped: int) -> NDArray[Any]:
    if rows == 0:
        return array
    return array[:, dropped:].transpose(0, 2, 1).reshape(len(array), array.shape[2], rows, columns)


def _end(
    taps: Mapping[str, str], expected: Sequence[NDArray[Any]], grids: Mapping[str, tuple[int, int, int]]
) -> bytes:
    """Make the graph from the values to the taps, as maps."""
    graph = Graph("taps")
    for tap, array in zip(taps, expected, strict=True):
        rows, columns, dropped = grids[tap]
        x = graph.input(
            f"value_{tap}", ("n", *array.shape[1:]), "float32" if array.itemsize == 4 else "float16"
        )
        size = array.shape[1:]
        if rows:
            size = (array.shape[2], rows, columns)
            patches = graph.slice(x, dropped, array.shape[1], 1)
            x = graph.reshape(graph.transpose(patches, 0, 2, 1), 0, *size)
        graph.output(tap, graph.op("Cast", x, to=1), ("n", *size))
    return graph.serialise()
