"""Validation 2: whether a bank of one position serves another position of the same part.

Banks are fitted on a fixed share of the nominal presses of the source position and a small share of those of the target
position: none, 5, 10 or 15 %. Nominal test presses, held out of both positions, and the defective presses of both are
scored. The measures are of both positions together, as in the paper, and of each alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset import Dataset
from calibration.studies.cells import Cell
from calibration.studies.detector_settings import overrides_for
from calibration.studies.material import Material, Place, material
from calibration.studies.presses import HeldOut, hold_out, opened, subset
from calibration.studies.rows import Rows
from calibration.studies.scoring import Scored, TestPresses, fit_and_score, measures
from calibration.studies.study import Options, chosen_places, prepare, run_cells
from edge import registry
from edge.core.detector import Nominal
from edge.core.errors import DatasetError

__all__ = ["STUDY", "TARGET_FRACTIONS", "CrossPosition", "cross_position_cells", "study_cross_position"]

STUDY = "cross-position"

TARGET_FRACTIONS = (0.0, 0.05, 0.10, 0.15)
"""Shares of the target position's pool, as in the paper."""


@dataclass(frozen=True)
class CrossPosition:
    """Evaluates a cell. taps: by backbone, those that are extracted for all cells."""

    dataset: Path
    cache: Path
    taps: Mapping[str, tuple[str, ...]]

    def places(self, cell: Cell) -> tuple[Place, Place]:
        """Where the features come from: the source position, then the target."""
        source, target = (
            Place(self.dataset, self.cache, cell.part, position, cell.backbone, self.taps[cell.backbone])
            for position in (cell.position, str(cell.setting("target")))
        )
        return source, target

    def __call__(self, cell: Cell) -> dict[str, Any]:
        source, target = (material(place) for place in self.places(cell))
        held = both_held_out(source, target, cell)
        rows = (
            subset(
                held[0].pool, max(1, round(float(cell.setting("fraction")) * len(held[0].pool))), cell.seed
            ),
            subset(
                held[1].pool, round(float(cell.setting("target_fraction")) * len(held[1].pool)), cell.seed
            ),
        )
        detector = registry.detector(cell.method)
        overrides = overrides_for(cell.method, cell.mode, cell.backbone)
        taps = detector.taps(detector.parameters(cell.mode, **overrides))
        tests = source.test(held[0].test, taps), target.test(held[1].test, taps)
        found = fit_and_score(
            detector,
            cell.mode,
            _nominal_of_both(source, target, rows, taps),
            source.taken.grid_of(taps),
            _test_of_both(*tests),
            seed=cell.seed,
            overrides=overrides,
            also=lambda scored: _of_each(scored, *tests),
        )
        return {
            **found,
            "source_presses": len(rows[0]),
            "target_presses": len(rows[1]),
            **source.facts,
            "target_pictures_sha256": target.facts["pictures_sha256"],
        }


def both_held_out(source: Material, target: Material, cell: Cell) -> tuple[HeldOut, HeldOut]:
    """The test presses and the pool of each position.

    Where complete specimens are held out, one that is tested at either position is learnt at none.
    """
    count = int(cell.setting("held_out"))
    first, second = (hold_out(found.presses, count, cell.split) for found in (source, target))
    if cell.split == "press":
        return first, second
    tested = {
        found.presses.specimens[row]
        for found, held in ((source, first), (target, second))
        for row in held.test
    }
    return _without(source, first, tested), _without(target, second, tested)


def _without(found: Material, held: HeldOut, tested: set[str | None]) -> HeldOut:
    pool = [row for row in held.pool if found.presses.specimens[row] not in tested]
    if not pool:
        raise DatasetError(
            f"every specimen of {found.presses.part}/{found.presses.position} is tested at one of the two positions, "
            "so none is left to learn from; press more specimens, or hold out fewer presses with --held-out"
        )
    return HeldOut(held.test, np.array(pool, np.int64))


def _nominal_of_both(
    source: Material, target: Material, rows: Sequence[NDArray[np.int64]], taps: Sequence[str]
) -> Nominal:
    own, other = source.nominal(rows[0], taps), target.nominal(rows[1], taps)
    return Nominal({tap: np.concatenate([own.features[tap], other.features[tap]]) for tap in taps})


def _test_of_both(source: TestPresses, target: TestPresses) -> TestPresses:
    return TestPresses(
        {tap: [*maps, *target.features[tap]] for tap, maps in source.features.items()},
        np.concatenate([source.masks, target.masks]),
        np.concatenate([source.is_defective, target.is_defective]),
    )


def _of_each(scored: Scored, source: TestPresses, target: TestPresses) -> dict[str, float | None]:
    """The measures of each position alone, such as `aupro_001_source`."""
    n = len(source)
    parts = {"source": (slice(None, n), source), "target": (slice(n, None), target)}
    return {
        f"{measure}_{name}": value
        for name, (rows, test) in parts.items()
        for measure, value in measures(Scored(scored.maps[rows], scored.scores[rows], ()), test).items()
    }


def cross_position_cells(
    places: Sequence[tuple[str, str, str]],
    options: Options,
    target_fractions: Sequence[float] = TARGET_FRACTIONS,
) -> list[Cell]:
    """All cells. places: (part, source, target). Errors: ConfigError for a method whose fraction is not known."""
    return [
        Cell(
            STUDY,
            part,
            source,
            method,
            mode,
            backbone,
            split,
            seed,
            (
                ("fraction", options.fraction_of(method, mode, backbone, split)),
                ("held_out", options.held_out),
                ("target", target),
                ("target_fraction", float(share)),
            ),
        )
        for part, source, target in places
        for backbone in options.backbones
        for seed in range(options.seeds)
        for share in target_fractions
        for split in options.splits
        for mode in options.modes
        for method in options.methods
    ]


def study_cross_position(options: Options, target: str | None = None) -> Rows:
    """Run the study; its rows are in the output folder.

    target: the target position, None is each part's second by name; parts with one position are left out. Errors:
    DatasetError, ConfigError, FitError, StoreError.
    """
    places = crossed_places(opened(options.dataset), options, target)
    cells = cross_position_cells(places, options)
    evaluate = CrossPosition(options.dataset.absolute(), options.features, options.taps())
    found = prepare((place for cell in cells for place in evaluate.places(cell)), options.jobs, options.show)
    for cell in {(c.part, c.backbone, c.split): c for c in cells}.values():
        source, other = (material(place) for place in evaluate.places(cell))
        both_held_out(source, other, cell)
    return run_cells(cells, evaluate, options, found)


def crossed_places(dataset: Dataset, options: Options, target: str | None) -> list[tuple[str, str, str]]:
    """(part, source, target) of every part with two positions.

    Errors: DatasetError where none has two, or a part that was asked for lacks a position.
    """
    known: dict[str, list[str]] = {}
    for part, position in dataset.positions:
        known.setdefault(part, []).append(position)
    places = []
    for part, source in chosen_places(dataset, options.parts, options.position):
        others = [position for position in known[part] if position != source]
        if target is not None and target not in others and part in options.parts:
            raise DatasetError(
                f"{part} has no position '{target}' other than its source '{source}'; it has {', '.join(known[part])}"
            )
        chosen = target if target in others else None if target else next(iter(others), None)
        if chosen is not None:
            places.append((part, source, chosen))
        elif part in options.parts:
            raise DatasetError(f"{part} has the one position {source}, so nothing can be carried to another")
    if not places:
        raise DatasetError(
            f"no part of dataset '{dataset.root}' has a second position{'' if target is None else f' {target}'}; "
            "this study needs nominal and defective presses at two positions of one part"
        )
    return places
