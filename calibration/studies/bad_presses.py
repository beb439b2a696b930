"""What damaged presses among the nominal ones cost: banks are fitted on presses of which a share is damaged.

Half of the defective presses may be mixed into the nominal ones, the other half is scored: the same half in every cell,
so that shares can be compared. The number of presses does not change; damaged ones take the place of nominal ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.studies.cells import Cell
from calibration.studies.detector_settings import overrides_for
from calibration.studies.good_fraction_study import GoodFraction, presses_in
from calibration.studies.material import Material, material
from calibration.studies.presses import TEST_SEED, hold_out, opened, subset
from calibration.studies.rows import Rows
from calibration.studies.scoring import TestPresses, fit_and_score
from calibration.studies.study import Options, chosen_places, prepare, run_cells
from edge import registry
from edge.core.errors import DatasetError

__all__ = ["BAD_SHARES", "STUDY", "BadPresses", "bad_presses_cells", "halves", "mixed", "study_bad_presses"]

STUDY = "bad-presses"

BAD_SHARES = (0.0, 0.02, 0.05, 0.10)
"""Shares of the presses that a bank learns from; at least one press for a share above zero."""


@dataclass(frozen=True)
class BadPresses(GoodFraction):
    """Evaluates a cell."""

    def __call__(self, cell: Cell) -> dict[str, Any]:
        found = material(self.place(cell))
        held = hold_out(found.presses, int(cell.setting("held_out")), cell.split)
        nominal = subset(held.pool, presses_in(cell, len(held.pool)), cell.seed)
        bad, tested = halves(found.presses.defective)
        rows = mixed(nominal, bad, float(cell.setting("bad")), cell.seed)
        detector = registry.detector(cell.method)
        overrides = overrides_for(cell.method, cell.mode, cell.backbone)
        taps = detector.taps(detector.parameters(cell.mode, **overrides))
        measured = fit_and_score(
            detector,
            cell.mode,
            found.nominal(rows, taps),
            found.taken.grid_of(taps),
            _test(found, held.test, tested, taps),
            seed=cell.seed,
            overrides=overrides,
        )
        return {**measured, "bad_presses": int(np.isin(rows, bad).sum()), **found.facts}


def halves(defective: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The defective presses that may be learnt, and those that are scored. Errors: DatasetError for one alone."""
    if len(defective) < 2:
        raise DatasetError(
            "a study of damaged presses among the nominal ones needs two defective presses at the position, one to "
            "learn and one to find; found one"
        )
    order = np.random.default_rng(TEST_SEED).permutation(defective)
    return np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])


def mixed(nominal: NDArray[np.int64], bad: NDArray[np.int64], share: float, seed: int) -> NDArray[np.int64]:
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


def _test(
    found: Material, nominal: NDArray[np.int64], defective: NDArray[np.int64], taps: Sequence[str]
) -> TestPresses:
    """Nominal test presses and half of the defective ones."""
    every = found.test(nominal, taps)
    chosen = np.concatenate([np.arange(len(nominal)), len(nominal) + defective - found.presses.nominal])
    return TestPresses(
        {tap: [maps[number] for number in chosen] for tap, maps in every.features.items()},
        every.masks[chosen],
        every.is_defective[chosen],
    )


def bad_presses_cells(
    places: Sequence[tuple[str, str]],
    options: Options,
    shares: Sequence[float] = BAD_SHARES,
) -> list[Cell]:
    """All cells. Errors: ConfigError for a method whose stable fraction is not known."""
    return [
        Cell(
            STUDY,
            part,
            position,
            method,
            mode,
            backbone,
            split,
            seed,
            (
                ("bad", float(share)),
                ("fraction", options.fraction_of(method, mode, backbone, split)),
                ("held_out", options.held_out),
            ),
        )
        for part, position in places
        for backbone in options.backbones
        for seed in range(options.seeds)
        for share in shares
        for split in options.splits
        for mode in options.modes
        for method in options.methods
    ]


def study_bad_presses(options: Options) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    places = chosen_places(opened(options.dataset), options.parts, options.position)
    cells = bad_presses_cells(places, options)
    evaluate = BadPresses(options.dataset.absolute(), options.features, options.taps())
    materials = prepare((evaluate.place(cell) for cell in cells), options.jobs, options.show)
    for found in materials:
        halves(found.presses.defective)
        for split in options.splits:
            hold_out(found.presses, options.held_out, split)
    return run_cells(cells, evaluate, options, materials)
