"""Validation 1: how many nominal presses a part needs.

Nominal presses of one position are held out for the test, the same in every cell; the defective presses of that
position are scored with them. Banks are fitted on a share of the other nominal presses (a fraction, or a number of
shots), which each seed draws.
"""

from collections.abc import Sequence
from typing import Any

from calibration.studies.cells import Cell
from calibration.studies.material import Drawn, fit_cell, material
from calibration.studies.presses import hold_out, opened, subset
from calibration.studies.rows import Rows
from calibration.studies.study import Evaluation, Options, chosen_places, make_cells, prepare, run_cells
from edge.core.errors import ConfigError, DatasetError

__all__ = ["FRACTIONS", "HELD_OUT", "SHOTS", "STUDY", "GoodFraction", "study_good_fraction"]

STUDY = "good-fraction"

FRACTIONS = tuple(k / 20 for k in range(1, 21))
"""5 to 100 % in steps of 5, as in the paper."""

SHOTS = (1, 2, 4, 8, 16, 32)
"""The numbers of presses that few-shot studies of the field report."""

HELD_OUT = 20
"""Nominal test presses, as in the paper."""


class GoodFraction(Evaluation):
    """Evaluates a cell: fits on its share of the pool, and scores the test presses."""

    def __call__(self, cell: Cell) -> dict[str, Any]:
        found = material(self.place(cell))
        held = hold_out(found.presses, int(cell.setting("held_out")), cell.split)
        rows = subset(held.pool, presses_in(cell, len(held.pool)), cell.seed)
        specimens = found.presses.specimens
        return {
            **fit_cell(cell, Drawn(found, rows, found.presses.tested(held))),
            "pool": len(held.pool),
            "specimens": len({specimens[row] for row in rows}),
        }


def presses_in(cell: Cell, pool: int) -> int:
    """How many presses a cell learns from. Errors: DatasetError for more shots than the pool has."""
    settings = dict(cell.settings)
    if "fraction" in settings:
        return max(1, round(float(settings["fraction"]) * pool))
    if (shots := int(settings["shots"])) > pool:
        raise DatasetError(
            f"{shots} presses are asked for, the pool of {cell.part}/{cell.position} has {pool}"
        )
    return shots


def study_good_fraction(
    options: Options, *, fractions: Sequence[float] = FRACTIONS, shots: Sequence[int] = SHOTS
) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    sizes = [{"fraction": float(share)} for share in fractions], [{"shots": int(count)} for count in shots]
    places = chosen_places(opened(options.dataset), options.parts, options.position)
    cells = [cell for place in places for cell in make_cells(STUDY, options, place, [*sizes[0], *sizes[1]])]
    if not cells:
        raise ConfigError("neither fractions nor shots are given, so there is nothing to study")
    evaluate = GoodFraction.of(options)
    materials = prepare(map(evaluate.place, cells), options)
    for found in materials:
        for split in options.splits:
            hold_out(found.presses, options.held_out, split)
    return run_cells(cells, evaluate, options, materials)
