"""Validation 1: how many nominal presses a part needs.

Nominal presses of one position are held out for the test, the same in every cell; the defective presses of that
position are scored with them. Banks are fitted on a share of the other nominal presses (a fraction, or a number of
shots), which each seed draws.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.experiments.harness.cells import Cell
from calibration.experiments.harness.figures import (
    Curve,
    curves,
    fraction_figure,
    gel_share,
    overview_figure,
    shots_figure,
)
from calibration.experiments.harness.intervals import MIN_DRAWS
from calibration.experiments.harness.material import Drawn, fit_cell, material
from calibration.experiments.harness.page import (
    Page,
    by_setup,
    cells_table,
    cost_table,
    only_scored,
    percent,
    refusals,
    section,
    split_table,
    table,
)
from calibration.experiments.harness.presses import hold_out, open_presses, subset
from calibration.experiments.harness.published import stable_fraction
from calibration.experiments.harness.rows import TIMES, Rows
from calibration.experiments.harness.stable import STABLE_WITHIN, stable_from
from calibration.experiments.harness.study import (
    Evaluation,
    Options,
    choose_places,
    make_cells,
    prepare,
    run_cells,
)
from edge.core.errors import ConfigError, DatasetError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = [
    "FRACTIONS",
    "HELD_OUT",
    "SHOTS",
    "STUDY",
    "GoodFraction",
    "page",
    "same_in_every_seed",
    "study_good_fraction",
]

STUDY = "good-fraction"

FRACTIONS = tuple(k / 20 for k in range(1, 21))
"""5 to 100 % in steps of 5, as in the paper."""

SHOTS = (1, 2, 4, 8, 16, 32)
"""The numbers of presses that few-shot studies of the field report."""

HELD_OUT = 20
"""Nominal test presses, as in the paper."""

SEEDS = 10
"""Of a complete study, as in the paper."""

_FIGURE_MEASURES = ("aupro_001", "auprc", "image_auroc")


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
    """Return how many presses a cell learns from. Errors: DatasetError for more shots than the pool has."""
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
    places = choose_places(open_presses(options.dataset), options.parts, options.position)
    cells = [cell for place in places for cell in make_cells(STUDY, options, place, [*sizes[0], *sizes[1]])]
    if not cells:
        raise ConfigError("neither fractions nor shots are given, so there is nothing to study")
    evaluate = GoodFraction.of(options)
    materials = prepare(map(evaluate.place, cells), options)
    for found in materials:
        for split in options.splits:
            hold_out(found.presses, options.held_out, split)
    return run_cells(cells, evaluate, options, materials)


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of this study."""
    scored = only_scored(rows)
    figures: dict[str, Callable[[], Figure]] = {}
    sections = [
        _head(rows),
        *(cells_table(rows[rows[size].notna()], size) for size in ("fraction", "shots") if size in rows),
    ]
    for title, group in by_setup(scored):
        drawn = dict(_figures(group))
        figures |= drawn
        sections += [_setup(title, group), *(f"![{name}]({name})\n" for name in drawn)]
    sections += [_splits(scored), refusals(rows)]
    if "fraction" in scored:
        sections += [cost_table(_quarters(scored), "fraction", percent), _complete(scored)]
    return Page("\n".join(section for section in sections if section), figures)


def _head(rows: "pd.DataFrame") -> str:
    where = ", ".join(sorted({f"{a} {b}" for a, b in zip(rows["part"], rows["position"], strict=True)}))
    held = int(rows["held_out"].max())
    return (
        "# How many nominal presses a part needs\n\n"
        f"{where}; {len(rows)} cells. Of each part {held} nominal presses are held "
        "out, the same in every cell, and scored with the defective presses of the same position. Banks are fitted on "
        "a share of the other nominal presses, the pool, which each seed draws. Intervals are of the mean over seeds, "
        "95 %, Student's t: they show how much the choice of training presses matters, and not what other test "
        f"presses would give. With fewer than {MIN_DRAWS} seeds, and with all presses, there is none. A gel is rated "
        f"for {DEFAULT_LIMIT_PRESSES} presses.\n"
    )


def _setup(title: str, rows: "pd.DataFrame") -> str:
    parts = [
        f"## {title}\n",
        _name_changes(rows),
        _plateaus(rows),
        _levels(rows),
        _shots(rows),
        _repeated(rows),
    ]
    return "\n".join(part for part in parts if part)


def _name_changes(rows: "pd.DataFrame") -> str:
    if "changed" not in rows:
        return ""
    pairs = rows.dropna(subset=["changed"])[["method", "changed"]].drop_duplicates()
    return "".join(
        f"{method} runs with {changed}, because the backbone lacks the taps that it reads in this mode.\n"
        for method, changed in pairs.itertuples(index=False)
    )


def _plateaus(rows: "pd.DataFrame") -> str:
    """The plateau of each method by the stated rule, in presses and gel."""
    if "fraction" not in rows:
        return ""
    lines = []
    for method, group in rows.dropna(subset=["fraction"]).groupby("method"):
        found = stable_from(group.astype(object).where(group.notna(), None).to_dict("records"))
        if found is None:
            continue
        paper, last = stable_fraction(method), group["fraction"].max()
        pools = group.groupby("part")["pool"].max()
        at = {part: max(1, round(found * pool)) for part, pool in pools.items()}
        lines.append(
            [
                method,
                percent(found) + (" (the largest: no plateau)" if found == last else ""),
                "-" if paper is None else percent(paper),
                ", ".join(f"{part} {count}" for part, count in at.items()),
                f"{100 * gel_share(max(at.values())):.0f} %",
            ]
        )
    heading = ["method", "plateau from", "the paper's", "presses", "of a gel's life, at most"]
    return (
        "**Plateau.** The smallest fraction from which on the mean over seeds is within "
        f"{STABLE_WITHIN:g} of that of the largest fraction, for every larger fraction, every part, and AU-PRO@0.01, "
        f"AUPRC and pixel AUROC together: one value for a method, as in the paper.\n\n{table(heading, lines)}"
    )


def _levels(rows: "pd.DataFrame") -> str:
    """AU-PRO at a few fractions."""
    found = sorted(curves(rows, "fraction", "aupro_001"), key=lambda c: (c.part, c.method))
    shown = _spread(sorted({x for curve in found for x in curve.x}))
    lines = [
        [curve.part, curve.method, int(curve.presses[-1]), *(_at(curve, x) for x in shown)] for curve in found
    ]
    heading = ["part", "method", "all presses", *map(percent, shown)]
    return section("**AU-PRO@0.01** at shares of the nominal presses, mean [interval]:", heading, lines)


def _shots(rows: "pd.DataFrame") -> str:
    """The field's few-shot curve."""
    found = sorted(curves(rows, "shots", "aupro_001"), key=lambda c: (c.part, c.method))
    shown = sorted({x for curve in found for x in curve.x})
    lines = [[curve.part, curve.method, *(_at(curve, x) for x in shown)] for curve in found]
    heading = ["part", "method", *(f"{x:g}" for x in shown)]
    return section("**AU-PRO@0.01** with few presses, mean [interval]:", heading, lines)


def _repeated(rows: "pd.DataFrame") -> str:
    """Name the cells of which all seeds are one computation."""
    same = same_in_every_seed(rows)
    lines = [
        [method, ", ".join(sorted(set(group["part"]))), ", ".join(_sizes(group)), int(group["seeds"].max())]
        for method, group in same.groupby("method")
    ]
    return section(
        "**One computation, not several.** Here all seeds give identical scores, because nothing random is left; that "
        "they do not scatter says nothing about robustness.",
        ["method", "parts", "at", "seeds"],
        lines,
    )


def _sizes(group: "pd.DataFrame") -> list[str]:
    fractions = group["fraction"].dropna().unique() if "fraction" in group else []
    shots = group["shots"].dropna().unique() if "shots" in group else []
    return [percent(f) for f in sorted(fractions)] + [f"{k:g} presses" for k in sorted(shots)]


def _splits(rows: "pd.DataFrame") -> str:
    """Compare the splits at fractions alone: shots are as many presses in both, of other specimens."""
    return split_table(rows.dropna(subset=["fraction"]), "fraction") if "fraction" in rows else ""


def _figures(rows: "pd.DataFrame") -> Iterator[tuple[str, Callable[[], "Figure"]]]:
    """File name of every figure of one setup, and what draws it."""
    setup = "-".join(str(rows[name].iloc[0]) for name in ("mode", "backbone", "split"))
    base = "good-fraction-" + re.sub(r"[^A-Za-z0-9_-]+", "-", setup)
    if "fraction" in rows and rows["fraction"].notna().any():
        for measure in _FIGURE_MEASURES:
            yield f"{base}-{measure}.svg", partial(overview_figure, rows, measure)
        for part in sorted(set(rows["part"])):
            yield f"{base}-{part}.svg", partial(fraction_figure, rows, part)
    if "shots" in rows and rows["shots"].notna().any():
        yield f"{base}-shots.svg", partial(shots_figure, rows)


def _complete(rows: "pd.DataFrame") -> str:
    """Estimate the time of a part's complete study, from the mean processor seconds of a cell at every fraction."""
    lines, stages = [], list(TIMES)
    cells = rows.dropna(subset=["fraction", *stages])
    cells = cells.assign(seconds=cells[stages].sum(axis=1))
    for (part, backbone, mode, split), group in cells.groupby(["part", "backbone", "mode", "split"]):
        means = group.groupby(["method", "fraction"])["seconds"].mean()
        each = {method: means[method] for method in sorted(set(group["method"]))}
        if min(map(len, each.values())) > 1:
            spent = sum(SEEDS * np.interp(FRACTIONS, at.index, at).sum() for at in each.values()) / 60
            pool = int(group["pool"].max()) if "pool" in group else int(group["presses"].max())
            lines.append([part, backbone, mode, split, pool, len(each), f"{spent:.0f}", f"{spent / 2:.0f}"])
    heading = ["part", "backbone", "mode", "split", "pool", "methods", "minutes of one core", "on two cores"]
    return section(
        f"**A complete part**, {len(FRACTIONS)} fractions with {SEEDS} seeds, takes by these cells (fractions between "
        f"them are interpolated; a busy machine takes longer):",
        heading,
        lines,
    )


def _at(curve: Curve, x: float) -> str:
    (where,) = (curve.x == x).nonzero()
    if not len(where):
        return "-"
    k = int(where[0])
    if not np.isfinite(curve.low[k]):
        return f"{curve.mean[k]:.3f}"
    return f"{curve.mean[k]:.3f} [{curve.low[k]:.3f}, {curve.high[k]:.3f}]"


def _spread(values: list[float]) -> list[float]:
    """Choose at most six of them, the first and the last included."""
    count = min(6, len(values))
    return [values[round(k * (len(values) - 1) / max(1, count - 1))] for k in range(count)]


def _quarters(rows: "pd.DataFrame") -> "pd.DataFrame":
    return rows[rows["fraction"].isin(_spread(sorted(rows["fraction"].dropna().unique())))]


def same_in_every_seed(rows: "pd.DataFrame") -> "pd.DataFrame":
    """Cells of several seeds whose scores are identical: one computation, whose lack of scatter says nothing.

    Columns part, method, fraction, shots (NaN where not varied) and seeds.
    """
    import pandas as pd

    sizes = [name for name in ("fraction", "shots") if name in rows]
    grouped = rows.groupby(["part", "method", *sizes], dropna=False)["scores_sha256"]
    found = pd.DataFrame({"seeds": grouped.size(), "results": grouped.nunique()}).reset_index()
    return found[(found["seeds"] > 1) & (found["results"] == 1)].drop(columns="results")
