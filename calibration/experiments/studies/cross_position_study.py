"""Validation 2: whether a bank of one position serves another position of the same part.

Banks are fitted on a fixed share of the nominal presses of the source position and a small share of those of the target
position: none, 5, 10 or 15 %. Nominal test presses, held out of both positions, and the defective presses of both are
scored. The measures are of both positions together, as in the paper, and of each alone.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.experiments.harness.cells import Cell
from calibration.experiments.harness.evidence import effects
from calibration.experiments.harness.figures import draw_curves
from calibration.experiments.harness.material import Drawn, Material, Place, fit_cell
from calibration.experiments.harness.page import (
    Figures,
    Page,
    figure_file,
    make_page,
    percent,
    share_of,
    tabulate_medians,
)
from calibration.experiments.harness.presses import HeldOut, hold_out, open_presses, subset
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.scoring import measures
from calibration.experiments.harness.study import (
    Evaluation,
    Options,
    choose_places,
    make_cells,
    positions_by_part,
    run_study,
)
from calibration.fitting.limits.held_out import ScoredPresses
from edge.core.errors import DatasetError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STUDY", "CrossPosition", "page", "study_cross_position"]

STUDY = "cross-position"

TARGET_FRACTIONS = (0.0, 0.05, 0.10, 0.15)
"""Shares of the target position's pool, as in the paper."""


class CrossPosition(Evaluation):
    """Evaluates a cell."""

    def places(self, cell: Cell) -> tuple[Place, Place]:
        """Return where the features come from: the source position, then the target."""
        return self.place(cell), self.place(cell, str(cell.setting("target")))

    def check(self, cell: Cell, *materials: Material) -> None:
        source, target = materials
        hold_out_both(source, target, cell)

    def measure(self, cell: Cell, *materials: Material) -> dict[str, Any]:
        source, target = materials
        held = hold_out_both(source, target, cell)
        shares = (float(cell.setting(name)) for name in ("fraction", "target_fraction"))
        counts = [round(share * len(one.pool)) for share, one in zip(shares, held, strict=True)]
        drawn = [
            Drawn(found, subset(one.pool, max(least, count), cell.seed), found.presses.tested(one))
            for found, one, count, least in zip((source, target), held, counts, (1, 0), strict=True)
        ]

        def measure_each(each: Sequence[ScoredPresses]) -> dict[str, float | None]:
            """Return the measures of each position alone, such as `aupro_001_source`."""
            tests = (one.material.test(one.tested) for one in drawn)
            return {
                f"{measure}_{name}": value
                for name, scored, test in zip(("source", "target"), each, tests, strict=True)
                for measure, value in measures(
                    scored.maps, scored.scores, test.masks, test.is_defective
                ).items()
            }

        return {
            **fit_cell(cell, *drawn, also=measure_each),
            "source_presses": len(drawn[0].learnt),
            "target_presses": len(drawn[1].learnt),
            "target_pictures_sha256": target.facts["pictures_sha256"],
        }


def hold_out_both(source: Material, target: Material, cell: Cell) -> tuple[HeldOut, HeldOut]:
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


def study_cross_position(options: Options) -> Rows:
    """Run the study; its rows are in the output folder. Parts with one position are left out.

    Errors: DatasetError, ConfigError, FitError, StoreError.
    """
    cells = [
        cell
        for part, source, target in find_pairs(options)
        for cell in make_cells(
            STUDY,
            options,
            (part, source),
            [{"target": target, "target_fraction": share} for share in TARGET_FRACTIONS],
        )
    ]
    return run_study(cells, CrossPosition, options)


def find_pairs(options: Options) -> list[tuple[str, str, str]]:
    """(part, source, target) of every part with two positions.

    Errors: DatasetError where none has two, or a part that was asked for lacks a position.
    """
    dataset, target = open_presses(options.dataset), options.target
    known, places = positions_by_part(dataset), []
    for part, source in choose_places(dataset, options.parts, options.position):
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


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of this study."""
    pairs = sorted(set(zip(rows["part"], rows["position"], rows["target"], strict=True)))
    where = "; ".join(f"{part}: {source} to {target}" for part, source, target in pairs)
    return make_page(STUDY, rows, "target_fraction", _describe, _draw, where=where)


def _draw(rows: "pd.DataFrame") -> Figures:
    label = "share of the second position's nominal presses, %"
    return {figure_file(rows): partial(draw_curves, rows, "target_fraction", label)}


def _describe(rows: "pd.DataFrame") -> dict[str, Any]:
    shares = sorted(rows["target_fraction"].unique())
    # From none to the first share, and from there to the last.
    steps = zip(shares, [*shares[1:2], *shares[-1:]], strict=False)
    names = {share: percent(share) for share in shares}
    return {
        "shares": share_of(rows),
        "medians": tabulate_medians(
            rows, "target_fraction", names, published={share: f"{share:g}" for share in shares}
        ),
        "effects": [
            (before, after, effects(rows, "target_fraction", before, after))
            for before, after in steps
            if before < after
        ],
        "alone": _tabulate_each(rows, names),
    }


def _tabulate_each(rows: "pd.DataFrame", names: dict[float, str]) -> "pd.DataFrame":
    """Return AU-PRO of each position alone: whether the second gains, and whether the first loses."""
    ends = {f"aupro_001_{name}": name for name in ("source", "target")}
    long = rows.melt(["method", "part", "target_fraction"], list(ends), "position").dropna(subset=["value"])
    long["position"] = long["position"].map(ends)
    medians = long.pivot_table("value", ["method", "part", "position"], "target_fraction", aggfunc="median")
    shown = medians.map(lambda value: "-" if np.isnan(value) else f"{value:.4f}")
    return shown.rename(columns=names).reset_index()
