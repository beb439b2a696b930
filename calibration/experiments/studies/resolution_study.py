"""Validation 3: what high resolution gives, and which of the differences between the two pictures gives it.

| view | picture | size | trunk |
|---|---|---|---|
| lr | 320x240, its central 224x224 | as it is | in one piece; the paper's low resolution |
| hr_tiled | 1280x720 | as it is | in tiles; the paper's high resolution |
| lr_tiled | 320x240 | scaled to 1280x720 | in tiles: as dense as hr_tiled, without its detail |
| hr_full | 1280x720 | as it is | in one piece: the detail of hr_tiled, without tiles |
| lr_full | 320x240 | as it is | in one piece: the field of view of hr_tiled, at low resolution |

Every view has the same normalisation of pixels, because it is part of the trunk. The common measures are computed in
the field of view of `lr`, on the pixels and masks of 1280x720. These cost much memory and time, so the pool of nominal
presses is capped; every view has the same capped pool.
"""

import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset import SIZES, resolution_of
from calibration.experiments.harness.cells import Cell, Split
from calibration.experiments.harness.evidence import effects
from calibration.experiments.harness.figures import draw_conditions
from calibration.experiments.harness.material import Drawn, Material, Place, fit_cell
from calibration.experiments.harness.page import Figures, Page, figure_file, make_page, tabulate_medians
from calibration.experiments.harness.pictures import LR_VIEW, PressPictures, View, find_centre, tile
from calibration.experiments.harness.presses import (
    TEST_SEED,
    HeldOut,
    StudyPresses,
    hold_out,
    open_presses,
    presses_of,
    subset,
)
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.scoring import measures
from calibration.experiments.harness.study import (
    Evaluation,
    Options,
    choose_places,
    make_cells,
    require_known,
    run_study,
)
from calibration.fitting.features import trunk_grid
from calibration.fitting.limits.held_out import ScoredPresses
from calibration.fitting.trunks import Trunk, open_trunk
from edge.core.arrays import F32, Mask
from edge.core.detector import Progress
from edge.core.errors import DatasetError, StoreError
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region
from edge.core.imaging.tiles import tiling
from edge.model.session import open_session

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["COMMON", "STUDY", "VIEWS", "ViewPlace", "cap_presses", "common_map", "page", "study_resolution"]

_LR, _HR = SIZES["lr"], SIZES["hr"]
# Across, as in the sensor profile of 1280x720; down it is three quarters of this.
_HR_PIXELS_PER_MM = LR_PIXELS_PER_MM * (_HR[0] // _LR[0])


_HR_FULL, _HR_TILED = (
    View(_HR, Region.full(_HR), _HR_PIXELS_PER_MM, is_tiled=tiled) for tiled in (False, True)
)

VIEWS: Mapping[str, View] = {
    "lr": LR_VIEW,
    "hr_tiled": _HR_TILED,
    "lr_tiled": replace(_HR_TILED, size=_LR, scaled_to=_HR),
    "hr_full": _HR_FULL,
    "lr_full": View(_LR, Region.full(_LR), LR_PIXELS_PER_MM),
}

COMMON = find_centre(_HR)
"""The field of view of `lr` in pixels of 1280x720."""


def common_map(pixels: NDArray[Any], view: View) -> F32:
    """A score map (h, w) of a view in the common field of view: float32 (COMMON.height, COMMON.width)."""
    score_map = np.asarray(pixels, np.float32)
    if view.region == LR_VIEW.region:
        return np.asarray(cv2.resize(score_map, (COMMON.width, COMMON.height)), np.float32)
    if score_map.shape != (_HR[1], _HR[0]):
        score_map = np.asarray(cv2.resize(score_map, _HR), np.float32)
    return np.ascontiguousarray(COMMON.crop(score_map))


STUDY = "resolution"

_IN_COMMON = ("aupro_001", "aupro_005", "auprc", "pixel_auroc")

_CONTROLS = (
    ("lr", "lr_tiled", "the tiles and the denser features, without more detail"),
    ("lr_tiled", "hr_tiled", "the detail alone: as many pixels, the same tiles"),
    ("hr_full", "hr_tiled", "the tiles alone, on the same pictures"),
    ("lr", "lr_full", "the field of view alone, at low resolution"),
)
"""Pairs of views that differ in little, and in what."""


@dataclass(frozen=True)
class ViewPlace(Place):
    """A place in one view."""

    view: str
    split: Split
    held_out: int
    most: int
    """Presses of the pool."""

    def __str__(self) -> str:
        return f"{self.part}/{self.position}, {self.view}, on {self.backbone}"

    def show(self, trunk: Trunk) -> Trunk:
        view = VIEWS[self.view]
        return tile(trunk, tiling(view.shape)) if view.is_tiled else trunk

    def covers(self, row: Mapping[str, Any]) -> bool:
        own = {"view": self.view, "split": self.split, "held_out": self.held_out, "most_presses": self.most}
        return super().covers(row) and all(row.get(name) == value for name, value in own.items())

    def require_room(self) -> None:
        view = VIEWS[self.view]
        trunk = self.show(open_trunk(self.backbone, self.taps))
        session = open_session(trunk.graph, 1, f"trunk '{trunk.id}'")
        grid = trunk_grid(session, self.taps, view.shape, view.pixels_per_mm)
        presses = len(cap_presses(self)[0].pictures)
        needed = 4 * presses * sum(math.prod(shape) for shape in grid.taps.values())
        self.cache.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(self.cache).free
        if needed > free:
            raise StoreError(
                f"the features of {self.part} in the view {self.view} on {self.backbone} need {needed / 1e9:.1f} GB, "
                f"'{self.cache}' has {free / 1e9:.1f} GB free; give another --cache, or fewer --presses"
            )

    def extract(self, progress: Progress = lambda fraction: None, threads: int = 1) -> "Seen":
        presses, held, pool = cap_presses(self)
        return Seen(self, presses, *self.take(presses, progress, threads), held, pool)


@dataclass(frozen=True)
class Seen(Material):
    """The presses of one part in one view."""

    held: HeldOut
    """Rows of them."""
    pool: int
    """Presses without the cap."""

    @cached_property
    def common(self) -> Mask:
        """The 1280x720 masks of the defective presses in the common field of view, bool (n, h, w).

        Errors: DatasetError for a press without 1280x720 pictures, and where all masks are empty there.
        """
        every = open_presses(self.place.dataset, "hr").select(self.place.part, self.place.position).presses
        fine = {press.path.name: press for press in every}
        for press in self.presses.pictures.presses:
            if press.path.name not in fine:
                raise DatasetError(
                    f"'{press.path}' has no 1280x720 picture of the same name; both are compared here"
                )
        defective = self.presses.pictures.presses[self.presses.nominal :]
        masks = np.stack([COMMON.crop(fine[press.path.name].mask()) for press in defective])
        if not masks.any():
            raise DatasetError(
                f"the 1280x720 masks of {self.place.part}/{self.place.position} are empty in the region that both "
                "resolutions show; export masks that show the damage"
            )
        return masks


class ResolutionStudy(Evaluation):
    """Evaluates a cell."""

    def place(self, cell: Cell, position: str | None = None) -> ViewPlace:
        return ViewPlace(
            **vars(super().place(cell, position)),
            view=str(cell.setting("view")),
            split=cell.split,
            held_out=int(cell.setting("held_out")),
            most=int(cell.setting("most_presses")),
        )

    def check(self, cell: Cell, *materials: "Seen") -> None:
        assert materials[0].common.any()  # else refused

    def measure(self, cell: Cell, *materials: "Seen") -> dict[str, Any]:
        (seen,) = materials
        rows = subset(seen.held.pool, max(1, round(float(cell.setting("fraction")) * seen.pool)), cell.seed)

        tested, view = seen.presses.tested(seen.held), VIEWS[str(cell.setting("view"))]

        def measure_in_common(each: Sequence[ScoredPresses]) -> dict[str, float | None]:
            """Return the measures of pixels in the common field of view, such as `aupro_001_common`."""
            maps = np.stack([common_map(one, view) for one in each[0].maps])
            blank = np.zeros((len(maps) - len(seen.common), *seen.common.shape[1:]), np.bool_)
            masks, is_defective = np.concatenate([blank, seen.common]), tested >= seen.presses.nominal
            found = measures(maps, each[0].scores, masks, is_defective)
            return {f"{name}_common": found[name] for name in _IN_COMMON}

        return {**fit_cell(cell, Drawn(seen, rows, tested), also=measure_in_common), "pool": seen.pool}


def cap_presses(place: ViewPlace) -> tuple[StudyPresses, HeldOut, int]:
    """The presses that the study looks at, which of them are for the test, and the size of the pool without the cap."""
    view = VIEWS[place.view]
    every = presses_of(open_presses(place.dataset, resolution_of(view.size)), place.part, place.position)
    held = hold_out(every, place.held_out, place.split)
    pool = subset(held.pool, place.most, TEST_SEED)
    rows = np.sort(np.concatenate([held.test, pool]))
    chosen = [every.pictures.presses[row] for row in (*rows, *every.defective)]
    presses = StudyPresses(place.part, place.position, PressPictures(tuple(chosen), view), len(rows))
    kept = HeldOut(np.searchsorted(rows, held.test), np.searchsorted(rows, pool))
    return presses, kept, len(held.pool)


def study_resolution(options: Options) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    views = tuple(dict.fromkeys(options.views or VIEWS))
    require_known("view", views, VIEWS)
    # View by view: the features of few are in memory at once.
    cells = [
        cell
        for place in fine_places(options)
        for view in views
        for cell in make_cells(STUDY, options, place, [{"view": view, "most_presses": options.presses}])
    ]
    return run_study(cells, ResolutionStudy, options)


def fine_places(options: Options) -> list[tuple[str, str]]:
    """(part, position) of every part with pictures of both resolutions.

    Errors: DatasetError where none has both, or a part that was asked for lacks one.
    """
    dataset = open_presses(options.dataset)
    places = choose_places(dataset, options.parts, options.position)
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


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of this study."""
    import pandas as pd

    views = pd.DataFrame(
        [_describe_view(name) for name in VIEWS], columns=["view", "picture", "inspected", "in tiles"]
    )
    return make_page(STUDY, rows, "view", _describe, _draw, views=views)


def _draw(rows: "pd.DataFrame") -> Figures:
    views = [view for view in VIEWS if view in set(rows["view"])]
    title = "AU-PRO@0.01, common field of view"
    draw = partial(draw_conditions, rows, "view", views, "aupro_001_common", title)
    return {figure_file(rows): draw}


def _describe_view(name: str) -> tuple[str, str, str, str]:
    view = VIEWS[name]
    scaled = view.scaled_to
    picture = "{}x{}".format(*view.size) + ("" if scaled is None else " scaled to {}x{}".format(*scaled))
    return (
        f"`{name}`",
        picture,
        f"{view.shape[1]}x{view.shape[0]}",
        "yes" if view.is_tiled else "no",
    )


def _describe(rows: "pd.DataFrame") -> dict[str, Any]:
    names = {view: f"`{view}`" for view in VIEWS if view in set(rows["view"])}
    is_compared = {"lr", "hr_tiled"} <= set(names)
    controls = [
        (before, after, what, effects(rows, "view", before, after, measures=("aupro_001_common",)))
        for before, after, what in _CONTROLS
    ]
    return {
        "medians": tabulate_medians(rows, "view", names, published={"lr": "lr", "hr_tiled": "hr"}),
        "effects": effects(rows, "view", "lr", "hr_tiled", {"hr_tiled": "hr"}) if is_compared else None,
        "common": tabulate_medians(rows, "view", names, "aupro_001_common"),
        "controls": [control for control in controls if len(control[-1])],
    }
