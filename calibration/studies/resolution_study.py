"""Validation 3: what high resolution gives, and which of the differences between the two pictures gives it.

The same presses are seen in the views of `calibration.studies.views`. 1280x720 pictures cost much memory and time, so
the pool of nominal presses is capped; every view has the same capped pool.
"""

import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset import LabelledPress
from calibration.fitting.features import trunk_grid
from calibration.fitting.trunks import open_trunk
from calibration.studies.cells import Cell, Split
from calibration.studies.detector_settings import overrides_for
from calibration.studies.feature_cache import FeatureCache
from calibration.studies.material import Material
from calibration.studies.pictures import PressPictures
from calibration.studies.presses import TEST_SEED, HeldOut, StudyPresses, hold_out, opened, presses_of, subset
from calibration.studies.rows import Rows, read_rows
from calibration.studies.runner import Show
from calibration.studies.scoring import Scored, TestPresses, fit_and_score, measures
from calibration.studies.study import (
    ROWS_FILE,
    Options,
    check_same,
    chosen_places,
    require_known,
    run_cells,
    say_once,
)
from calibration.studies.views import COMMON, VIEWS, common_map, tiled
from edge import registry
from edge.core.detector import Progress
from edge.core.errors import DatasetError, StoreError
from edge.model.session import open_session

__all__ = ["MOST_PRESSES", "STUDY", "ResolutionStudy", "resolution_cells", "study_resolution"]

STUDY = "resolution"

MOST_PRESSES = 40
"""Nominal presses of the pool, by default."""


@dataclass(frozen=True)
class Seen:
    """The presses of one part in one view. held_out: rows of them. common: masks in the common field of view."""

    material: Material
    held: HeldOut
    pool: int
    common: NDArray[np.bool_]


@dataclass(frozen=True)
class ViewPlace:
    """What identifies features: as `calibration.studies.material.Place`, with the view, the split and the cap."""

    dataset: Path
    cache: Path
    part: str
    position: str
    backbone: str
    taps: tuple[str, ...]
    view: str
    split: Split
    held_out: int
    most: int


@dataclass(frozen=True)
class ResolutionStudy:
    """Evaluates a cell. taps: by backbone, those that are extracted for all cells."""

    dataset: Path
    cache: Path
    taps: Mapping[str, tuple[str, ...]]

    def place(self, cell: Cell) -> ViewPlace:
        """Where the cell's features come from."""
        return ViewPlace(
            self.dataset,
            self.cache,
            cell.part,
            cell.position,
            cell.backbone,
            self.taps[cell.backbone],
            str(cell.setting("view")),
            cell.split,
            int(cell.setting("held_out")),
            int(cell.setting("most_presses")),
        )

    def __call__(self, cell: Cell) -> dict[str, Any]:
        seen = seen_at(self.place(cell))
        count = max(1, round(float(cell.setting("fraction")) * seen.pool))
        rows = subset(seen.held.pool, count, cell.seed)
        detector = registry.detector(cell.method)
        overrides = overrides_for(cell.method, cell.mode, cell.backbone)
        taps = detector.taps(detector.parameters(cell.mode, **overrides))
        found = fit_and_score(
            detector,
            cell.mode,
            seen.material.nominal(rows, taps),
            seen.material.taken.grid_of(taps),
            test := seen.material.test(seen.held.test, taps),
            seed=cell.seed,
            overrides=overrides,
            also=lambda scored: _in_common(scored, seen.common, test.is_defective, str(cell.setting("view"))),
        )
        return {**found, "pool": seen.pool, **seen.material.facts}


def _in_common(
    scored: Scored, masks: NDArray[np.bool_], is_defective: NDArray[np.bool_], view: str
) -> dict[str, float | None]:
    """The measures of pixels in the common field of view, such as `aupro_001_common`."""
    maps = np.stack([common_map(one, VIEWS[view]) for one in scored.maps])
    blank = np.zeros((len(maps) - len(masks), *masks.shape[1:]), np.bool_)
    test = TestPresses({}, np.concatenate([blank, masks]), is_defective)
    found = measures(Scored(maps, scored.scores, ()), test)
    return {f"{name}_common": found[name] for name in ("aupro_001", "aupro_005", "auprc", "pixel_auroc")}


@lru_cache(maxsize=2)
def seen_at(place: ViewPlace) -> Seen:
    """The presses of a place in its view; features come from the cache."""
    return look(place)


def look(place: ViewPlace, progress: Progress = lambda fraction: None, threads: int = 1) -> Seen:
    """The same, with the progress of an extraction. Errors: DatasetError, FitError, ConfigError, StoreError."""
    presses, held, pool = capped_presses(place)
    trunk = tiled(open_trunk(place.backbone, place.taps), VIEWS[place.view])
    taken = FeatureCache(place.cache).features(trunk, place.taps, presses.pictures, progress, threads)
    found = Material(presses=presses, backbone=place.backbone, trunk=trunk, taken=taken)
    return Seen(found, held, pool, _common_masks(place, presses))


def capped_presses(place: ViewPlace) -> tuple[StudyPresses, HeldOut, int]:
    """The presses that the study looks at, which of them are for the test, and the size of the pool without the cap."""
    view = VIEWS[place.view]
    every = presses_of(opened(place.dataset, view.resolution), place.part, place.position)
    held = hold_out(every, place.held_out, place.split)
    pool = subset(held.pool, place.most, TEST_SEED)
    rows = np.sort(np.concatenate([held.test, pool]))
    chosen = [every.pictures.presses[row] for row in (*rows, *every.defective)]
    presses = StudyPresses(place.part, place.position, PressPictures(tuple(chosen), view.view), len(rows))
    kept = HeldOut(np.searchsorted(rows, held.test), np.searchsorted(rows, pool))
    return presses, kept, len(held.pool)


def _common_masks(place: ViewPlace, presses: StudyPresses) -> NDArray[np.bool_]:
    """The 1280x720 masks of the defective presses in the common field of view, bool (n, h, w).

    Errors: DatasetError for a press without 1280x720 pictures, and where all masks are empty there.
    """
    fine = {press.path.name: press for press in _fine_presses(place)}
    defective = [presses.pictures.presses[row] for row in presses.defective]
    for press in presses.pictures.presses:
        if press.path.name not in fine:
            raise DatasetError(
                f"'{press.path}' has no 1280x720 picture of the same name; both are compared here"
            )
    masks = np.stack([COMMON.crop(fine[press.path.name].mask()) for press in defective])
    if not masks.any():
        raise DatasetError(
            f"the 1280x720 masks of {place.part}/{place.position} are empty in the region that both resolutions "
            "show; export masks that show the damage"
        )
    return masks


def _fine_presses(place: ViewPlace) -> tuple[LabelledPress, ...]:
    return opened(place.dataset, "hr").select(place.part, place.position).presses


def resolution_cells(
    places: Sequence[tuple[str, str]],
    options: Options,
    views: Sequence[str] = tuple(VIEWS),
    most_presses: int = MOST_PRESSES,
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
                ("fraction", options.fraction_of(method, mode, backbone, split)),
                ("held_out", options.held_out),
                ("most_presses", most_presses),
                ("view", view),
            ),
        )
        for part, position in places
        for backbone in options.backbones
        for view in views
        for split in options.splits
        for seed in range(options.seeds)
        for mode in options.modes
        for method in options.methods
    ]


def study_resolution(options: Options, views: Sequence[str] = (), most_presses: int = MOST_PRESSES) -> Rows:
    """Run the study; its rows are in the output folder. views: all if empty.

    Errors: DatasetError, ConfigError, FitError, StoreError.
    """
    views = tuple(dict.fromkeys(views or VIEWS))
    require_known("view", views, VIEWS)
    places = fine_places(options)
    cells = resolution_cells(places, options, views, most_presses)
    evaluate = ResolutionStudy(options.dataset.absolute(), options.features, options.taps())
    _extract_all(list(dict.fromkeys(evaluate.place(cell) for cell in cells)), options)
    return run_cells(cells, evaluate, options)


def fine_places(options: Options) -> list[tuple[str, str]]:
    """(part, position) of every part with pictures of both resolutions.

    Errors: DatasetError where none has both, or a part that was asked for lacks one.
    """
    dataset = opened(options.dataset)
    places = chosen_places(dataset, options.parts, options.position)
    both = [
        (part, position)
        for part, position in places
        if all((options.dataset / part / position / name).is_dir() for name in ("rgb", "rgb_320x240"))
    ]
    lacking = [pair for pair in places if pair not in both]
    if lacking and options.parts:
        raise DatasetError(
            f"{'/'.join(lacking[0])} of dataset '{options.dataset}' has pictures of one resolution only; this study "
            "compares rgb (1280x720) with rgb_320x240"
        )
    if not both:
        raise DatasetError(
            f"dataset '{options.dataset}' has no position with both rgb (1280x720) and rgb_320x240; "
            "`gelgate lab simulate paper` makes one"
        )
    return both


def _extract_all(places: Sequence[ViewPlace], options: Options) -> None:
    """Features of every place in the cache, before any cell runs.

    Errors: as `look`; StoreError for a small disk; ConfigError for rows from other pictures or another trunk.
    """
    rows, remarks = read_rows(options.output / ROWS_FILE), list[str]()
    for place in places:
        _check_room(place)
        seen = _extract(place, min(options.jobs, os.cpu_count() or 1), options.show)
        check_same(
            (row for row in rows if _is_of(row, place)),
            [seen.material],
            options.output / ROWS_FILE,
            partial(tiled, view=VIEWS[place.view]),
        )
        remarks += seen.material.remarks
    say_once(remarks)


def _is_of(row: Mapping[str, Any], place: ViewPlace) -> bool:
    """Whether a row was made from the pictures of a place."""
    own: dict[str, object] = {"study": STUDY, "view": place.view, "split": place.split}
    own |= {"held_out": place.held_out, "most_presses": place.most}
    return all(row.get(name) == value for name, value in own.items())


def _extract(place: ViewPlace, threads: int, show: Show) -> Seen:
    what = f"features of {place.part}/{place.position}, {place.view}, on {place.backbone}"
    with show(what, 100) as advance:
        return look(place, lambda share: advance(int(100 * share)), threads)


def _check_room(place: ViewPlace) -> None:
    """Refuse features that do not fit on the disk. Errors: StoreError."""
    view = VIEWS[place.view]
    trunk = tiled(open_trunk(place.backbone, place.taps), view)
    session = open_session(trunk.graph, 1, f"trunk '{trunk.id}'")
    grid = trunk_grid(session, place.taps, view.view.shape, view.view.pixels_per_mm)
    presses = capped_presses(place)[0]
    needed = 4 * len(presses.pictures) * sum(math.prod(shape) for shape in grid.taps.values())
    place.cache.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(place.cache).free
    if needed > free:
        raise StoreError(
            f"the features of {place.part} in the view {place.view} on {place.backbone} need {needed / 1e9:.1f} GB, "
            f"'{place.cache}' has {free / 1e9:.1f} GB free; give another --cache, or fewer --presses"
        )
