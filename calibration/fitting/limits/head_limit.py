"""A head that gives its score map in units of a `MapLimit`: the same arithmetic, appended to the detector's graph.

The limit's arrays are further arrays of the bank, so the gateway, the exports and other programs score such a bundle
as any other.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.map_limit import MapLimit
from edge.core.detector import Bank
from edge.core.errors import FitError

__all__ = [
    "ARRAYS", "Operation", "bank_with", "can_extend", "extend_head", "head_inputs", "head_with_limit", "limit_arrays",
    "limit_like",
]  # fmt: skip

_MAP, _SCORE = "score_map", "score"
_RAW_MAP, _RAW_SCORE = "limit_raw_map", "limit_raw_score"

ARRAYS = (
    "limit_grid",
    "limit_guard",
    "limit_rows",
    "limit_columns",
    "limit_window_down_rows",
    "limit_window_down_columns",
    "limit_window_up_rows",
    "limit_window_up_columns",
)
"""Every array that a limit may add to a bank. Columns are transposed: they multiply from the right."""

# Reductions take their axes as an input from this opset on.
_OLDEST_OPSET = 18


@dataclass(frozen=True)
class Operation:
    """One standard operation."""

    kind: str
    inputs: tuple[str, ...]
    output: str
    axes: tuple[int, ...] = ()
    """For a reduction; they become an int64 constant of the graph."""
    is_kept: bool = False
    """Whether the axes stay, with one element each."""


def extend_head(
    head: bytes,
    renamed: Mapping[str, str],
    inputs: Mapping[str, Sequence[int]],
    operations: Sequence[Operation],
    constants: Mapping[str, float] = MappingProxyType({}),
) -> bytes:
    """Append operations to a head; what they give takes the place of the head's own values of those names.

    renamed: values of the head to their new names; an operation gives each of the old ones. inputs: name to shape of
    each further float32 input. constants: name to value of each further float32 constant, (1, 1). Errors: FitError for
    bytes that are no model, or a node with a graph of its own, which may read any value by name.
    """
    from onnx import TensorProto, helper, numpy_helper

    model = _load(head)
    graph = model.graph
    for node in graph.node:
        if any(attribute.HasField("g") or attribute.graphs for attribute in node.attribute):
            raise FitError(f"its node '{node.name}' has a graph of its own, which may read any value by name")
        node.input[:] = [renamed.get(name, name) for name in node.input]
        node.output[:] = [renamed.get(name, name) for name in node.output]
    declared = [value for value in graph.value_info if value.name not in renamed]
    graph.ClearField("value_info")
    graph.value_info.extend(declared)
    for name, shape in inputs.items():
        graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape)))
    for name, value in constants.items():
        graph.initializer.append(numpy_helper.from_array(np.full((1, 1), value, np.float32), name))
    for operation in operations:
        names, attributes = list(operation.inputs), dict[str, int]()
        if operation.axes:
            names.append(f"{operation.output}_axes")
            graph.initializer.append(numpy_helper.from_array(np.array(operation.axes, np.int64), names[-1]))
            attributes["keepdims"] = int(operation.is_kept)
        label = f"appended {operation.kind} of {' and '.join(operation.inputs)}"
        graph.node.append(helper.make_node(operation.kind, names, [operation.output], label, **attributes))
    return bytes(model.SerializeToString(deterministic=True))


def head_inputs(head: bytes) -> list[str]:
    """Name the inputs of a head. Errors: FitError for bytes that are no model."""
    return [str(value.name) for value in _load(head).graph.input]


def _load(head: bytes) -> Any:
    import onnx
    from google.protobuf.message import DecodeError

    try:
        return onnx.load_from_string(head)
    except DecodeError as error:
        raise FitError(f"it is no ONNX model: {error}") from error


def can_extend(head: bytes) -> bool:
    """Tell whether a limit can be appended to this head."""
    try:
        _extended(head, {"limit_grid": np.ones((1, 1)), "limit_guard": np.ones((1, 1))})
    except FitError:
        return False
    versions = [entry.version for entry in _load(head).opset_import if entry.domain in ("", "ai.onnx")]
    return max(versions, default=0) >= _OLDEST_OPSET


def limit_arrays(limit: MapLimit) -> dict[str, NDArray[np.float32]]:
    """Return the limit as arrays of a bank."""
    arrays = {"limit_grid": limit.grid, "limit_guard": np.full((1, 1), limit.guard)}
    if limit.of.places is not None:
        rows, columns = limit.of.places.up
        arrays |= {"limit_rows": rows, "limit_columns": columns.T}
    if limit.of.around is not None:
        (down_rows, down_columns), (up_rows, up_columns) = limit.of.around.down, limit.of.around.up
        arrays |= {"limit_window_down_rows": down_rows, "limit_window_down_columns": down_columns.T}
        arrays |= {"limit_window_up_rows": up_rows, "limit_window_up_columns": up_columns.T}
    return {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}


def bank_with(bank: Bank, arrays: Mapping[str, NDArray[Any]]) -> Bank:
    """Add arrays to a bank. Errors: FitError for a detector with an array of such a name."""
    taken = sorted(bank.arrays.keys() & set(arrays))
    if taken:
        raise FitError(f"the detector's bank has an array '{taken[0]}', a name that limits use; rename it")
    return Bank({**bank.arrays, **arrays}, bank.packing, bank.facts)


def head_with_limit(head: bytes, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Append the arrays' limit to a head. Errors: FitError for a head that cannot be extended."""
    try:
        return _extended(head, arrays)
    except FitError as error:
        raise FitError(f"no limit can be appended to the head: {error}") from error


def limit_like(whole: Mapping[str, NDArray[Any]], head: bytes, bank: Bank) -> tuple[bytes, Bank]:
    """Give a head and its bank the limit that another bank's arrays hold; unchanged where it has none."""
    arrays = {name: whole[name] for name in ARRAYS if name in whole}
    return (head_with_limit(head, arrays), bank_with(bank, arrays)) if arrays else (head, bank)


def _extended(head: bytes, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    shapes = {name: array.shape for name, array in arrays.items()}
    return extend_head(head, {_MAP: _RAW_MAP, _SCORE: _RAW_SCORE}, shapes, list(_operations(arrays)))


def _operations(arrays: Mapping[str, NDArray[Any]]) -> Iterator[Operation]:
    """List the operations of `MapLimit.relate`."""
    contrast, limit = _RAW_MAP, "limit_grid"
    if "limit_window_down_rows" in arrays:
        yield Operation("MatMul", ("limit_window_down_rows", _RAW_MAP), "limit_rows_averaged")
        yield Operation("MatMul", ("limit_rows_averaged", "limit_window_down_columns"), "limit_averaged")
        yield Operation("MatMul", ("limit_window_up_rows", "limit_averaged"), "limit_rows_raised")
        yield Operation("MatMul", ("limit_rows_raised", "limit_window_up_columns"), "limit_surroundings")
        yield Operation("Sub", (_RAW_MAP, "limit_surroundings"), "limit_contrast")
        contrast = "limit_contrast"
    if "limit_rows" in arrays:
        yield Operation("MatMul", ("limit_rows", "limit_grid"), "limit_of_rows")
        yield Operation("MatMul", ("limit_of_rows", "limit_columns"), "limit_of_places")
        limit = "limit_of_places"
    yield Operation("Div", (contrast, limit), "limit_relative")
    yield Operation("Div", (_RAW_MAP, "limit_guard"), "limit_relative_raw")
    yield Operation("Max", ("limit_relative", "limit_relative_raw"), _MAP)
    yield Operation("ReduceMax", (_MAP,), _SCORE, axes=(1, 2))
