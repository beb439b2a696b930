"""The page of the resolution study, from its rows."""

from functools import partial
from typing import TYPE_CHECKING

from calibration.studies.effects import COMPARED, effects, medians
from calibration.studies.figures import conditions_figure, svg
from calibration.studies.page import Page
from calibration.studies.page_parts import (
    by_setup,
    cells_table,
    compared_table,
    cost_table,
    effects_table,
    figure_name,
    only_scored,
    paper_note,
    refusals,
    seeds_of,
    split_table,
    table,
)
from calibration.studies.published import published
from calibration.studies.resolution_study import STUDY
from calibration.studies.views import VIEWS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]

_COMMON = tuple(f"{measure}_common" for measure in COMPARED)

_CONTROLS = (
    ("lr", "lr_tiled", "the tiles and the denser features, without more detail"),
    ("lr_tiled", "hr_tiled", "the detail alone: as many pixels, the same tiles"),
    ("hr_full", "hr_tiled", "the tiles alone, on the same pictures"),
    ("lr", "lr_full", "the field of view alone, at low resolution"),
)
"""Pairs of views that differ in little, and in what."""


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of this study."""
    scored = only_scored(rows)
    setups = list(by_setup(scored))
    figures = {figure_name(STUDY, group): partial(_figure, group) for _, group in setups}
    sections = [_head(rows), cells_table(rows, "view")]
    for (title, group), name in zip(setups, figures, strict=True):
        sections += [_setup(title, group), f"![{title}]({name})\n"]
    sections += [split_table(scored, "view"), refusals(rows), cost_table(scored, "view")]
    return Page("\n".join(section for section in sections if section), figures)


def _figure(rows: "pd.DataFrame") -> str:
    views = [view for view in VIEWS if view in set(rows["view"])]
    title = "AU-PRO@0.01, common field of view"
    return svg(conditions_figure(rows, "view", views, "aupro_001_common", title))


def _head(rows: "pd.DataFrame") -> str:
    return (
        "# Does high resolution pay?\n\n"
        f"Parts {', '.join(sorted(rows['part'].unique()))}; at most {int(rows['most_presses'].max())} nominal presses "
        f"in the pool, the same for every view; {int(rows['held_out'].max())} nominal presses and all defective ones "
        f"are scored. Medians over {seeds_of(rows, 'view')} seeds.\n\n{paper_note()}\n"
        f"{table(['view', 'picture', 'inspected', 'in tiles'], map(_described, VIEWS))}\n"
        "Every view has the same normalisation of pixels: it is part of the trunk. The paper's low and high resolution "
        "differ in field of view, masks and share of damaged pixels; the common measures are computed in the field of "
        "view of `lr`, on the pixels and masks of 1280x720, for every view.\n"
    )


def _described(name: str) -> tuple[str, str, str, str]:
    view = VIEWS[name]
    scaled = view.view.scaled_to
    picture = "{}x{}".format(*view.view.size) + ("" if scaled is None else " scaled to {}x{}".format(*scaled))
    return (
        f"`{name}`",
        picture,
        f"{view.view.shape[1]}x{view.view.shape[0]}",
        "yes" if view.is_tiled else "no",
    )


def _setup(title: str, rows: "pd.DataFrame") -> str:
    paper, ours = published(STUDY), medians(rows, "view")
    views = [view for view in VIEWS if view in set(rows["view"])]
    names = {"lr": "lr", "hr_tiled": "hr"}
    conditions = [(view, names.get(view, ""), f"`{view}`") for view in views]
    parts = [f"## {title}\n"]
    parts += [compared_table(ours, paper, measure, conditions) for measure in COMPARED]
    if {"lr", "hr_tiled"} <= set(views):
        found = effects(rows, "view", "lr", "hr_tiled", paper, ("lr", "hr"))
        parts.append(
            effects_table(found, "From low resolution to high resolution in tiles, each on its own masks")
        )
    return "\n".join(
        [*parts, "### Common field of view and masks\n", *_common(rows, conditions), *_controls(rows)]
    )


def _common(rows: "pd.DataFrame", conditions: list[tuple[str, str, str]]) -> list[str]:
    common = medians(rows, "view", _COMMON)
    return [compared_table(common, {}, measure, conditions) for measure in _COMMON]


def _controls(rows: "pd.DataFrame") -> list[str]:
    """What each control shows, by the common AU-PRO."""
    found = []
    for before, after, what in _CONTROLS:
        measured = effects(rows, "view", before, after, {}, ("", ""), ("aupro_001_common",))
        lines = [[e.method, e.part, f"{e.difference:+.4f}", e.ours] for e in measured]
        if lines:
            heading = ["method", "part", "mean difference of AU-PRO@0.01", "direction"]
            found.append(f"From `{before}` to `{after}`: {what}.\n\n{table(heading, lines)}")
    return found
