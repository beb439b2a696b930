"""Validation 1: how many nominal presses a part needs.

Nominal presses of one position are held out for the test, the same in every cell; the defective presses of that
position are scored with them. Banks are fitted on a share of the other nominal presses (a fraction, or a number of
shots), which each seed draws.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.studies.cells import Cell, Split
from calibration.studies.detector_settings import overrides_for, written
from calibration.studies.material import Place, material
from calibration.studies.presses import hold_out, opened, subset
from calibration.studies.rows import Rows
from calibration.studies.scoring import fit_and_score
from calibration.studies.study import Options, chosen_places, prepare, run_cells
from edge import registry
from edge.core.detector import Mode
from edge.core.errors import ConfigError, DatasetError

__all__ = [
    "FRACTIONS",
    "HELD_OUT",
    "SHOTS",
    "STUDY",
    "GoodFraction",
    "good_fraction_cells",
    "study_good_fraction",
]

STUDY = "good-fraction"

FRACTIONS = tuple(k / 20 for k in range(1, 21))
"""5 to 100 % in steps of 5, as in the paper."""

SHOTS = (1, 2, 4, 8, 16, 32)
"""The numbers of presses that few-shot studies of the field report."""

HELD_OUT = 20
"""Nominal test presses, as in the paper."""


@dataclass(frozen=True)
class GoodFraction:
    """Evaluates a cell: fits on its share of the pool, and scores the test presses.

    taps: by backbone, those that are extracted for all cells.
    """

    dataset: Path
    cache: Path
    taps: Mapping[str, tuple[str, ...]]

    def place(self, cell: Cell) -> Place:
        """Where the cell's features come from."""
        return Place(
            self.dataset, self.cache, cell.part, cell.position, cell.backbone, self.taps[cell.backbone]
        )

    def __call__(self, cell: Cell) -> dict[str, Any]:
        found = material(self.place(cell))
        detector = registry.detector(cell.method)
        held = hold_out(found.presses, int(cell.setting("held_out")), cell.split)
        rows = subset(held.pool, presses_in(cell, len(held.pool)), cell.seed)
        overrides = overrides_for(cell.method, cell.mode, cell.backbone)
        taps = detector.taps(detector.parameters(cell.mode, **overrides))
        specimens = found.presses.specimens
        measured = fit_and_score(
            detector,
            cell.mode,
            found.nominal(rows, taps),
            found.taken.grid_of(taps),
            found.test(held.test, taps),
            seed=cell.seed,
            overrides=overrides,
        )
        return {
            **measured,
            "pool": len(held.pool),
            "specimens": len({specimens[row] for row in rows}),
            **found.facts,
            **({"changed": written(overrides)} if overrides else {}),
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


def good_fraction_cells(
    places: Sequence[tuple[str, str]],
    methods: Sequence[str],
    *,
    modes: Sequence[Mode] = ("corrected",),
    backbones: Sequence[str],
    splits: Sequence[Split] = ("press",),
    seeds: int = 10,
    fractions: Iterable[float] = FRACTIONS,
    shots: Iterable[int] = SHOTS,
    held_out: int = HELD_OUT,
) -> list[Cell]:
    """All cells. places: (part, position) pairs.

    The seed is the outer loop within a part and backbone, so that an interrupted study has complete curves of fewer
    seeds, and the time left is estimated from cells of every kind.
    """
    sizes = [(("fraction", float(f)), ("held_out", held_out)) for f in fractions]
    sizes += [(("held_out", held_out), ("shots", int(k))) for k in shots]
    return [
        Cell(STUDY, part, position, method, mode, backbone, split, seed, settings)
        for part, position in places
        for backbone in backbones
        for seed in range(seeds)
        for settings in sizes
        for split in splits
        for mode in modes
        for method in methods
    ]


def study_good_fraction(
    options: Options, *, fractions: Sequence[float] = FRACTIONS, shots: Sequence[int] = SHOTS
) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    places = chosen_places(opened(options.dataset), options.parts, options.position)
    cells = good_fraction_cells(
        places,
        options.methods,
        modes=options.modes,
        backbones=options.backbones,
        splits=options.splits,
        seeds=options.seeds,
        fractions=fractions,
        shots=shots,
        held_out=options.held_out,
    )
    if not cells:
        raise ConfigError("neither fractions nor shots are given, so there is nothing to study")
    evaluate = GoodFraction(options.dataset.absolute(), options.features, options.taps())
    materials = prepare((evaluate.place(cell) for cell in cells), options.jobs, options.show)
    for found in materials:
        for split in options.splits:
            hold_out(found.presses, options.held_out, split)
    return run_cells(cells, evaluate, options, materials)
