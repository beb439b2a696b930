"""A head that also answers for missing relief: the arithmetic of `MissingRelief`, appended to the detector's graph.

Its arrays are further arrays of the bank, as those of a limit. The score map is the larger of the detector's and of the
map of missing relief.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.head_limit import Operation, bank_with, extend_head
from calibration.fitting.limits.missing_relief import FAINT, START, STEEPNESS, TINY, MissingRelief
from edge.core.detector import Bank
from edge.core.errors import FitError
from edge.model.manifest_facts import MISSING

__all__ = ["ARRAYS", "head_with_relief", "relief_arrays", "relieve_like"]

_MAP, _SCORE = "score_map", "score"
_OWN_MAP, _OWN_SCORE = "relief_own_map", "relief_own_score"

ARRAYS = (
    "relief_free",
    "relief_level",
    "relief_weights",
    "relief_middle",
    "relief_weakest",
    "relief_expected",
    "relief_rows",
    "relief_columns",
    "relief_unit",
)
"""Every array that missing relief adds to a bank. Columns are transposed: they multiply from the right."""

_CONSTANTS = {
    "relief_half": 0.5,
    "relief_one": 1.0,
    "relief_faint": FAINT,
    "relief_faint_and_one": FAINT + 1,
    "relief_start": START,
    "relief_steepness": STEEPNESS,
    "relief_tiny": TINY,
}


def relief_arrays(relief: MissingRelief) -> dict[str, NDArray[np.float32]]:
    """The arrays of a bank."""
    scalars = {"level": relief.level, "weakest": relief.weakest, "unit": relief.unit}
    arrays = {f"relief_{name}": np.full((1, 1), value) for name, value in scalars.items()} | {
        "relief_free": relief.free,
        "relief_weights": relief.weights[None, :, None, None],
        "relief_middle": np.array([-relief.middle]),
        "relief_expected": relief.expected,
        "relief_rows": relief.rows,
        "relief_columns": relief.columns.T,
    }
    return {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}


def head_with_relief(head: bytes, tap: str, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The head with the arrays' `MissingRelief` of a tap that it reads. Errors: FitError, it cannot be extended."""
    shapes = {name: arrays[name].shape for name in ARRAYS}
    renamed = {_MAP: _OWN_MAP, _SCORE: _OWN_SCORE}
    try:
        # The operations of `MissingRelief.score_map`.
        return extend_head(head, renamed, shapes, [*_cells(tap), *_press(), *_map()], _CONSTANTS)
    except FitError as error:
        raise FitError(f"missing relief cannot be appended to the head: {error}") from error


def relieve_like(
    whole: Mapping[str, NDArray[Any]], facts: Mapping[str, Any], head: bytes, bank: Bank
) -> tuple[bytes, Bank]:
    """Give a head and its bank the missing relief that another bank's arrays hold; unchanged where it has none.

    facts: of the other bundle. Errors: FitError.
    """
    arrays = {name: whole[name] for name in ARRAYS if name in whole}
    if not arrays:
        return head, bank
    return head_with_relief(head, facts[MISSING]["tap"], arrays), bank_with(bank, arrays)


def _cells(tap: str) -> list[Operation]:
    """Compute how much each cell touches, and what it lacks, (n, rows, columns) each."""
    return [
        Operation("Sub", (tap, "relief_free"), "relief_added"),
        Operation("ReduceL2", ("relief_added",), "relief_distance", axes=(1,)),
        Operation("Div", ("relief_distance", "relief_level"), "relief_levels"),
        Operation("Sub", ("relief_levels", "relief_half"), "relief_above"),
        Operation("Relu", ("relief_above",), "relief_touching"),
        Operation("Min", ("relief_touching", "relief_one"), "relief_contact"),
        Operation("Conv", (tap, "relief_weights", "relief_middle"), "relief_lack_plane"),
        Operation("ReduceSum", ("relief_lack_plane",), "relief_lack", axes=(1,)),
        Operation("Mul", ("relief_contact", "relief_lack"), "relief_lacking"),
    ]


def _press() -> list[Operation]:
    """Compute how much is missing in all, `relief_missing` (n, 1, 1)."""
    return [
        Operation("ReduceSum", ("relief_contact",), "relief_cells", axes=(1, 2), is_kept=True),
        Operation("ReduceSum", ("relief_lacking",), "relief_lacked", axes=(1, 2), is_kept=True),
        Operation("Add", ("relief_cells", "relief_weakest"), "relief_of_cells"),
        Operation("Div", ("relief_lacked", "relief_of_cells"), "relief_smooth"),
        Operation("Mul", ("relief_cells", "relief_faint"), "relief_many_cells"),
        Operation("Add", ("relief_many_cells", "relief_weakest"), "relief_more_cells"),
        Operation("Mul", ("relief_weakest", "relief_faint_and_one"), "relief_least"),
        Operation("Div", ("relief_least", "relief_more_cells"), "relief_faintness"),
        Operation("Max", ("relief_smooth", "relief_faintness"), "relief_missing"),
    ]


def _map() -> list[Operation]:
    return [
        Operation("Relu", ("relief_lacking",), "relief_lacking_places"),
        Operation("Sub", ("relief_expected", "relief_contact"), "relief_untouched"),
        Operation("Relu", ("relief_untouched",), "relief_untouched_places"),
        Operation("Add", ("relief_lacking_places", "relief_untouched_places"), "relief_places"),
        Operation("MatMul", ("relief_rows", "relief_places"), "relief_raised_rows"),
        Operation("MatMul", ("relief_raised_rows", "relief_columns"), "relief_shown"),
        Operation("ReduceMax", ("relief_shown",), "relief_peak", axes=(1, 2), is_kept=True),
        Operation("Add", ("relief_peak", "relief_tiny"), "relief_some_peak"),
        Operation("Sub", ("relief_missing", "relief_start"), "relief_beyond"),
        Operation("Mul", ("relief_beyond", "relief_steepness"), "relief_steep"),
        Operation("Relu", ("relief_steep",), "relief_begun"),
        Operation("Min", ("relief_begun", "relief_one"), "relief_share"),
        Operation("Mul", ("relief_missing", "relief_share"), "relief_height"),
        Operation("Mul", ("relief_height", "relief_unit"), "relief_score"),
        Operation("Div", ("relief_score", "relief_some_peak"), "relief_scale"),
        Operation("Mul", ("relief_shown", "relief_scale"), "relief_map"),
        Operation("ReduceMax", ("relief_map",), "relief_highest", axes=(1, 2)),
        Operation("Max", (_OWN_MAP, "relief_map"), _MAP),
        Operation("Max", (_OWN_SCORE, "relief_highest"), _SCORE),
    ]
