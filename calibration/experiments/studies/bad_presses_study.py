"""What damaged presses among the nominal ones cost: banks are fitted on presses of which a share is damaged.

Half of the defective presses may be mixed into the nominal ones, the other half is scored: the same half in every cell,
so that shares can be compared. The number of presses does not change; damaged ones take the place of nominal ones.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.cells import Cell
from calibration.experiments.harness.evidence import effects
from calibration.experiments.harness.material import Drawn, Material, fit_cell
from calibration.experiments.harness.page import Page, make_page, percent, share_of, tabulate_medians
from calibration.experiments.harness.presses import TEST_SEED, hold_out, open_presses, subset
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.study import Evaluation, Options, choose_places, make_cells, run_study
from calibration.experiments.studies.good_fraction_study import count_presses
from edge.core.errors import DatasetError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["BAD_SHARES", "STUDY", "halve", "mix_presses", "page", "study_bad_presses"]

STUDY = "bad-presses"

BAD_SHARES = (0.0, 0.02, 0.05, 0.10)
"""Shares of the presses that a bank learns from; at least one press for a share above zero."""


class BadPresses(Evaluation):
    """Evaluates a cell."""

    def check(self, cell: Cell, *materials: Material) -> None:
        super().check(cell, *materials)
        halve(materials[0].presses.defective)

    def measure(self, cell: Cell, *materials: Material) -> dict[str, Any]:
        (material,) = materials
        held = hold_out(material.presses, int(cell.setting("held_out")), cell.split)
        nominal = subset(held.pool, count_presses(cell, len(held.pool)), cell.seed)
        bad, tested = halve(material.presses.defective)
        rows = mix_presses(nominal, bad, float(cell.setting("bad")), cell.seed)
        measured = fit_cell(cell, Drawn(material, rows, np.concatenate([held.test, tested])))
        return {**measured, "bad_presses": int(np.isin(rows, bad).sum())}


def halve(defective: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The defective presses that may be learnt, and those that are scored. Errors: DatasetError for one alone."""
    if len(defective) < 2:
        raise DatasetError(
            "a study of damaged presses among the nominal ones needs two defective presses at the position, one to "
            "learn and one to find; found one"
        )
    order = np.random.default_rng(TEST_SEED).permutation(defective)
    return np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])


def mix_presses(
    nominal: NDArray[np.int64], bad: NDArray[np.int64], share: float, seed: int
) -> NDArray[np.int64]:
    """The nominal presses with a share of them replaced by damaged ones, drawn by the seed.

    Errors: DatasetError where that takes more damaged presses than there are, or leaves no nominal one.
    """
    count = max(1, round(share * len(nominal))) if share else 0
    if count > len(bad) or count >= len(nominal):
        raise DatasetError(
            f"{share:.0%} of {len(nominal)} presses are {count} damaged ones; {len(bad)} can be learnt from, and one "
            "nominal press must remain; give a smaller share, or a smaller --fraction"
        )
    rng = np.random.default_rng([seed, 1])
    kept = rng.permutation(nominal)[count:]
    return np.sort(np.concatenate([kept, rng.permutation(bad)[:count]]))


def study_bad_presses(options: Options) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    places = choose_places(open_presses(options.dataset), options.parts, options.position)
    shares = [{"bad": share} for share in BAD_SHARES]
    cells = [cell for place in places for cell in make_cells(STUDY, options, place, shares)]
    return run_study(cells, BadPresses, options)


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of this study."""
    return make_page(STUDY, rows, "bad", _describe)


def _describe(rows: "pd.DataFrame") -> dict[str, Any]:
    shares = sorted(rows["bad"].unique())
    return {
        "shares": share_of(rows),
        "medians": tabulate_medians(rows, "bad", {share: percent(share) for share in shares}),
        "first": shares[0],
        "last": shares[-1],
        "effects": effects(rows, "bad", shares[0], shares[-1], measures=("aupro_001",)),
    }
