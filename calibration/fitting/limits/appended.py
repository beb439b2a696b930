"""What is appended to a detector's head: the limit of each place, the check of missing relief, taught places and drawn
regions.

Their arrays are further arrays of the bank, so the gateway, the exports and other programs score such a bundle as any
other. The same arithmetic in NumPy is `map_limit.relate` and `relief_step.find_missing`.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank
from edge.core.errors import FitError
from edge.model.manifest import REGION_WEIGHTS
from edge.model.pipe import RELIEF_MAP

__all__ = ["TAUGHT_WEIGHTS", "append", "extend_head", "find_obstacle", "head_inputs"]

_LIMIT = """
    limit_rows_averaged = MatMul (limit_window_down_rows, limit_raw_score_map)
    limit_averaged = MatMul (limit_rows_averaged, limit_window_down_columns)
    limit_rows_raised = MatMul (limit_window_up_rows, limit_averaged)
    limit_surroundings = MatMul (limit_rows_raised, limit_window_up_columns)
    limit_around = Relu (limit_surroundings)
    limit_above_usual = Add (limit_around, limit_usual)
    limit_contrast = Div (limit_raw_score_map, limit_above_usual)
    limit_relative = Div (limit_contrast, limit_grid)
    limit_relative_raw = Div (limit_raw_score_map, limit_guard)
    score_map = Max (limit_relative, limit_relative_raw)
    score = ReduceMax <keepdims = 0> (score_map, limit_axes)
"""
_LIMIT_CONSTANTS = "int64[2] limit_axes = {1, 2}"

# How much each cell touches and what it lacks; how much is missing of the press; the map of the places.
_RELIEF = """
    relief_added = Sub ({tap}, relief_free)
    relief_distance = ReduceL2 <keepdims = 0> (relief_added, relief_channels)
    relief_levels = Div (relief_distance, relief_level)
    relief_above = Sub (relief_levels, relief_half)
    relief_touching = Relu (relief_above)
    relief_contact = Min (relief_touching, relief_one)
    relief_lack_plane = Conv ({tap}, relief_weights, relief_middle)
    relief_lack = ReduceSum <keepdims = 0> (relief_lack_plane, relief_channels)
    relief_lacking = Mul (relief_contact, relief_lack)

    relief_cells = ReduceSum <keepdims = 1> (relief_contact, relief_axes)
    relief_lacked = ReduceSum <keepdims = 1> (relief_lacking, relief_axes)
    relief_of_cells = Add (relief_cells, relief_weakest)
    relief_smooth = Div (relief_lacked, relief_of_cells)
    relief_many_cells = Mul (relief_cells, relief_ten)
    relief_more_cells = Add (relief_many_cells, relief_weakest)
    relief_least = Mul (relief_weakest, relief_eleven)
    relief_faintness = Div (relief_least, relief_more_cells)
    relief_missing = Max (relief_smooth, relief_faintness)

    relief_lacking_places = Relu (relief_lacking)
    relief_untouched = Sub (relief_expected, relief_contact)
    relief_untouched_places = Relu (relief_untouched)
    relief_places = Add (relief_lacking_places, relief_untouched_places)
    relief_raised_rows = MatMul (relief_rows, relief_places)
    relief_shown = MatMul (relief_raised_rows, relief_columns)
    relief_peak = ReduceMax <keepdims = 1> (relief_shown, relief_axes)
    relief_some_peak = Add (relief_peak, relief_tiny)
    relief_beyond = Sub (relief_missing, relief_start)
    relief_steep = Mul (relief_beyond, relief_ten)
    relief_begun = Relu (relief_steep)
    relief_share = Min (relief_begun, relief_one)
    relief_height = Mul (relief_missing, relief_share)
    relief_score = Mul (relief_height, relief_unit)
    relief_scale = Div (relief_score, relief_some_peak)
    relief_map = Mul (relief_shown, relief_scale)
    relief_highest = ReduceMax <keepdims = 0> (relief_map, relief_axes)
    score_map = Max (relief_raw_score_map, relief_map)
    score = Max (relief_raw_score, relief_highest)
"""
_RELIEF_CONSTANTS = """int64[1] relief_channels = {1}, int64[2] relief_axes = {1, 2}, float relief_half = {0.5},
    float relief_one = {1}, float relief_ten = {10}, float relief_eleven = {11}, float relief_start = {0.9},
    float relief_tiny = {1e-12}"""

TAUGHT_WEIGHTS = "taught_weights"
"""The array of the bank by which a score map is multiplied, (h, w): more than 1 at places of damage that was taught."""

_TAUGHT = """
    score_map = Mul (taught_raw_score_map, taught_weights)
    taught_plane = Unsqueeze (score_map, taught_axis)
    taught_peak = GlobalMaxPool (taught_plane)
    score = Reshape (taught_peak, taught_flat)
"""
_TAUGHT_CONSTANTS = "int64[1] taught_axis = {1}, int64[1] taught_flat = {-1}"

# Relief that is missing from a press is no matter of the place where it shows most.
_REGIONS = """
    region_weighed = Mul (region_raw_score_map, region_weights)
    score_map = Max ({shown})
    region_plane = Unsqueeze (score_map, region_axis)
    region_peak = GlobalMaxPool (region_plane)
    score = Reshape (region_peak, region_flat)
"""
_REGIONS_CONSTANTS = "int64[1] region_axis = {1}, int64[1] region_flat = {-1}"

# Reductions take their axes as an input from this opset on.
_OLDEST_OPSET = 18


def append(head: bytes, bank: Bank, arrays: Mapping[str, NDArray[Any]], tap: str = "") -> tuple[bytes, Bank]:
    """Append the limit, the check of missing relief, the taught places and the regions of these arrays; nothing without
    any.

    arrays: also those of a complete bundle, whose own arrays are left out. tap: whose features the check reads. Errors:
    FitError for a head that cannot be extended, or a bank with an array of such a name.
    """
    if "limit_grid" in arrays:
        head, bank = _append(head, bank, arrays, _LIMIT, _LIMIT_CONSTANTS, "limit_raw_")
    if "relief_free" in arrays:
        text = _RELIEF.format(tap=tap)
        head, bank = _append(head, bank, arrays, text, _RELIEF_CONSTANTS, "relief_raw_", RELIEF_MAP)
    if TAUGHT_WEIGHTS in arrays:
        head, bank = _append(head, bank, arrays, _TAUGHT, _TAUGHT_CONSTANTS, "taught_raw_")
    if REGION_WEIGHTS in arrays:
        text = _REGIONS.format(shown=f"region_weighed{', relief_map' * ('relief_free' in bank.arrays)}")
        head, bank = _append(head, bank, arrays, text, _REGIONS_CONSTANTS, "region_raw_")
    return head, bank


def _append(
    head: bytes,
    bank: Bank,
    arrays: Mapping[str, NDArray[Any]],
    text: str,
    constants: str,
    raw: str,
    shown: str = "",
) -> tuple[bytes, Bank]:
    words = set(re.findall(r"\w+", text))
    read = {name: array.astype(np.float32) for name, array in arrays.items() if name in words}
    if taken := sorted(bank.arrays.keys() & read.keys()):
        raise FitError(f"the detector's bank has an array '{taken[0]}', a name that limits use; rename it")
    renamed = {name: f"{raw}{name}" for name in ("score_map", "score")}
    try:
        head = extend_head(
            head, renamed, {name: array.shape for name, array in read.items()}, text, constants, shown
        )
    except FitError as error:
        raise FitError(f"the head cannot be extended by a limit: {error}") from error
    return head, Bank({**bank.arrays, **read}, bank.packing, bank.facts)


def extend_head(
    head: bytes,
    renamed: Mapping[str, str],
    inputs: Mapping[str, tuple[int, ...]],
    text: str,
    constants: str = "",
    shown: str = "",
) -> bytes:
    """Append operations to a head; what they give takes the place of the head's own values of those names.

    renamed: values of the head to their new names; an operation gives each of the old ones. inputs: name to shape of
    each further float32 input. text, constants: in the syntax of onnx.parser. shown: a map among the values of the text
    that is an output too. Errors: FitError for bytes that are no model, or a node with a graph of its own, which may
    read any value by name.
    """
    import onnx.parser
    from onnx import TensorProto, helper

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
    more = onnx.parser.parse_graph(f"more () => () <{constants}> {{{text}}}")
    for node in more.node:
        node.name = f"appended {node.op_type} of {' and '.join(node.input)}"
    graph.node.extend(more.node)
    graph.initializer.extend(more.initializer)
    if shown:
        graph.output.append(helper.make_tensor_value_info(shown, TensorProto.FLOAT, [None, None, None]))
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


def find_obstacle(head: bytes) -> str:
    """Return why no limit can be appended to this head; empty where one can."""
    try:
        append(head, Bank({}), {"limit_grid": np.ones((1, 1))})
    except FitError as error:
        return str(error)
    versions = [entry.version for entry in _load(head).opset_import if entry.domain in ("", "ai.onnx")]
    opset = max(versions, default=0)
    return "" if opset >= _OLDEST_OPSET else f"the head has opset {opset}, a limit needs {_OLDEST_OPSET}"
