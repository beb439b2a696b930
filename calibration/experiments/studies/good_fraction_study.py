"""Validation 1: how many nominal presses a part needs.

Nominal presses of one position are held out for the test, the same in every cell; the defective presses of that
position are scored with them. Banks are fitted on a share of the other nominal presses (a fraction, or a number of
shots), which each seed draws.
"""

import re
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.experiments.harness.cells import Cell, Setting
from calibration.experiments.harness.evidence import MIN_DRAWS, STABLE_WITHIN, stable_from
from calibration.experiments.harness.figures import draw_overview, draw_shots, find_curves
from calibration.experiments.harness.material import Drawn, Material, fit_cell
from calibration.experiments.harness.page import Figures, Page, make_page, percent
from calibration.experiments.harness.presses import hold_out, open_presses, subset
from calibration.experiments.harness.published import stable_fraction
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.study import Evaluation, Options, choose_places, make_cells, run_study
from edge.core.errors import ConfigError, DatasetError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STUDY", "page", "study_good_fraction"]

STUDY = "good-fraction"


class GoodFraction(Evaluation):
    """Evaluates a cell: fits on its share of the pool, and scores the test presses."""

    def measure(self, cell: Cell, *materials: Material) -> dict[str, Any]:
        (material,) = materials
        held = hold_out(material.presses, int(cell.setting("held_out")), cell.split)
        rows = subset(held.pool, count_presses(cell, len(held.pool)), cell.seed)
        specimens = material.presses.specimens
        return {
            **fit_cell(cell, Drawn(material, rows, material.presses.tested(held))),
            "pool": len(held.pool),
            "specimens": len({specimens[row] for row in rows}),
        }


def count_presses(cell: Cell, pool: int) -> int:
    """Return how many presses a cell learns from. Errors: DatasetError for more shots than the pool has."""
    settings = dict(cell.settings)
    if "fraction" in settings:
        return max(1, round(float(settings["fraction"]) * pool))
    if (shots := int(settings["shots"])) > pool:
        raise DatasetError(
            f"{shots} presses are asked for, the pool of {cell.part}/{cell.position} has {pool}"
        )
    return shots


def study_good_fraction(options: Options) -> Rows:
    """Run the study; its rows are in the output folder. Errors: DatasetError, ConfigError, FitError, StoreError."""
    varied: list[dict[str, Setting]] = [{"fraction": share} for share in options.fractions]
    varied += [{"shots": count} for count in options.shots]
    if not varied:
        raise ConfigError("neither fractions nor shots are given, so there is nothing to study")
    places = choose_places(open_presses(options.dataset), options.parts, options.position)
    cells = [cell for place in places for cell in make_cells(STUDY, options, place, varied)]
    return run_study(cells, GoodFraction, options)


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of this study."""
    where = ", ".join(sorted(set(rows["part"] + " " + rows["position"])))
    known = rows if "fraction" in rows else rows.assign(fraction=np.nan)
    return make_page(
        STUDY,
        known,
        "fraction",
        _describe,
        _draw,
        where=where,
        min_draws=MIN_DRAWS,
        gel_presses=DEFAULT_LIMIT_PRESSES,
        stable_within=STABLE_WITHIN,
    )


def _describe(rows: "pd.DataFrame") -> dict[str, Any]:
    changed = rows.reindex(columns=["method", "changed"]).dropna().drop_duplicates()
    return {
        "changed": list(changed.itertuples(index=False)),
        "plateaus": _tabulate_plateaus(rows.dropna(subset=["fraction"])),
        "levels": _tabulate_levels(rows, "fraction"),
        "shots": _tabulate_levels(rows, "shots"),
    }


def _tabulate_plateaus(rows: "pd.DataFrame") -> "pd.DataFrame | None":
    """Return the plateau of each method by the stated rule, in presses and gel."""
    import pandas as pd

    lines = []
    for method, group in rows.groupby("method"):
        plateau = stable_from(group)
        if plateau is None:
            continue
        paper, is_last = stable_fraction(method), plateau == group["fraction"].max()
        at = (plateau * group.groupby("part")["pool"].max()).round().clip(lower=1).astype(int)
        lines.append(
            {
                "method": method,
                "plateau from": percent(plateau) + (" (the largest: no plateau)" if is_last else ""),
                "the paper's": "-" if paper is None else percent(paper),
                "presses": ", ".join(f"{part} {count}" for part, count in at.items()),
                "of a gel's life, at most": f"{100 * (at.max() / DEFAULT_LIMIT_PRESSES):.0f} %",
            }
        )
    return pd.DataFrame(lines) if lines else None


def _tabulate_levels(rows: "pd.DataFrame", size: str) -> "pd.DataFrame | None":
    """Return AU-PRO with its interval at a few fractions, or at all shots."""
    curves = find_curves(rows, size, "aupro_001")
    if curves.empty:
        return None
    every = sorted(curves.index.get_level_values(size).unique())
    shown = _spread(every) if size == "fraction" else every
    texts = curves.apply(_write_level, axis=1).unstack().reindex(columns=shown).fillna("-")
    if size == "shots":
        return texts.rename(columns="{:g}".format).reset_index()
    texts.insert(0, "all presses", curves.groupby(["part", "method"])["presses"].last().astype(int))
    return texts.rename(columns=dict(zip(shown, map(percent, shown), strict=True))).reset_index()


def _write_level(at: "pd.Series[float]") -> str:
    interval = f" [{at['low']:.3f}, {at['high']:.3f}]" if np.isfinite(at["low"]) else ""
    return f"{at['mean']:.3f}{interval}"


def _draw(rows: "pd.DataFrame") -> Figures:
    setup = "-".join(str(rows[name].iloc[0]) for name in ("mode", "backbone", "split"))
    base, figures = f"{STUDY}-" + re.sub(r"[^A-Za-z0-9_-]+", "-", setup), {}
    if rows["fraction"].nunique() > 1:
        figures[f"{base}.svg"] = partial(draw_overview, rows)
    if "shots" in rows and rows["shots"].notna().any():
        figures[f"{base}-shots.svg"] = partial(draw_shots, rows)
    return figures


def _spread(values: list[float]) -> list[float]:
    """Choose at most four of them, the first and the last included."""
    count = min(4, len(values))
    return [values[round(k * (len(values) - 1) / max(1, count - 1))] for k in range(count)]
