"""Figures of the studies, as matplotlib figures and as SVG text that is the same in every run."""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibration.experiments.harness.evidence import are_drawn, mean_interval

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_conditions", "draw_curves", "draw_overview", "draw_shots", "find_curves", "svg"]

_MEASURE_NAMES = {
    "aupro_001": "AU-PRO@0.01",
    "aupro_005": "AU-PRO@0.05",
    "auprc": "AUPRC",
    "pixel_auroc": "pixel AUROC",
    "image_auroc": "image AUROC",
    "recall_001": "recall at 1 % false alarms",
}

# Okabe and Ito's palette: readers with any kind of colour vision can distinguish it.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

_PANEL = (4.2, 3.1)  # inches

_SHARE = "share of the nominal presses, %"


def find_curves(rows: "pd.DataFrame", x: str, measure: str) -> "pd.DataFrame":
    """Return mean, low and high over seeds, and presses, by part, method and x. rows: of one backbone, mode and split.

    x: the column that varies, such as `fraction`. low, high: of the 95 % interval; nan where presses were not drawn.
    """
    import pandas as pd

    points = {}
    if x in rows and measure in rows:
        known = rows.dropna(subset=[x, measure])
        for key, cell in known.assign(drawn=are_drawn(known)).groupby(["part", "method", x]):
            values = cell[measure].to_numpy(np.float64)
            interval = mean_interval(values) if cell["drawn"].any() else (np.nan, np.nan)
            points[key] = (values.mean(), *interval, cell["presses"].max())
    index = pd.MultiIndex.from_tuples(list(points), names=["part", "method", x]) if points else None
    return pd.DataFrame(list(points.values()), index, columns=["mean", "low", "high", "presses"])


def draw_overview(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """Draw a panel per method, a line per part, against the fraction. rows: of one backbone, mode and split."""
    return draw_curves(rows, "fraction", _SHARE, measure, panel="method", with_dots=False)


def draw_shots(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """Draw a panel per part, a line per method, against the number of presses on a logarithmic axis."""
    figure = draw_curves(rows, "shots", "nominal presses", measure, scale=1)
    for axis in figure.axes:
        if axis.has_data():
            axis.set_xscale("log", base=2)
            own = rows[(rows["part"] == axis.get_title(loc="left")) & rows[measure].notna()]
            shots = sorted(own["shots"].dropna().unique())
            axis.set_xticks(shots, [f"{x:g}" for x in shots])
    return figure


def draw_conditions(
    rows: "pd.DataFrame", column: str, order: Sequence[str], measure: str, title: str
) -> "Figure":
    """Draw a panel per part, a line per method, over named conditions in an order."""
    figure = draw_curves(rows.assign(place=rows[column].map(order.index)), "place", "", measure, scale=1)
    for axis in figure.axes:
        if axis.has_data():
            axis.set_xticks(range(len(order)), list(order))
            axis.set_ylabel(title, fontsize=8)
    return figure


def draw_curves(
    rows: "pd.DataFrame",
    x: str,
    label: str,
    measure: str = "aupro_001",
    *,
    panel: str = "part",
    scale: float = 100,
    with_dots: bool = True,
) -> "Figure":
    """Draw a panel per part, a line per method: the mean, its interval as a band, and a dot for each seed.

    x: the column that varies. panel: `part` or `method`, the other one has the lines. scale: of x.
    """
    line = "method" if panel == "part" else "part"
    curves = find_curves(rows, x, measure).reset_index()
    figure, axes = _panels(curves[panel].nunique() if len(curves) else 0)
    names = sorted(set(curves.get(line, ())))
    for axis, (title, group) in zip(axes, curves.groupby(panel) if len(curves) else (), strict=False):
        for name, curve in group.groupby(line):
            colour, at = _COLOURS[names.index(name) % len(_COLOURS)], scale * curve[x].astype(float)
            axis.plot(at, curve["mean"], color=colour, label=name, linewidth=1.3)
            axis.fill_between(at, curve["low"], curve["high"], color=colour, alpha=0.15, linewidth=0)
            if with_dots:
                seeds = rows[(rows[panel] == title) & (rows[line] == name)].dropna(subset=[x, measure])
                seeds = seeds.sort_values(x, kind="stable")
                dots = scale * seeds[x].astype(float), seeds[measure]
                axis.plot(*dots, ".", color=colour, markersize=2.5, alpha=0.6)
        _label(axis, title, label, measure)
    return figure


def svg(figure: "Figure") -> str:
    """Return the figure's SVG: no date, and identifiers that do not depend on the process."""
    import matplotlib as mpl

    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "gelgate", "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def _panels(count: int) -> tuple["Figure", Sequence["Axes"]]:
    """A figure of at most three panels a row. It belongs to no window and no global state."""
    from matplotlib.figure import Figure

    columns = min(3, max(1, count))
    rows = max(1, -(-count // columns))
    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for spare in axes[max(1, count) :]:
        spare.set_axis_off()
    return figure, list(axes[: max(1, count)])


def _label(axis: "Axes", title: str, x: str, measure: str) -> None:
    axis.set_title(title, fontsize=9, loc="left")
    axis.set_xlabel(x, fontsize=8)
    axis.set_ylabel(_MEASURE_NAMES.get(measure, measure), fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, linewidth=0.5)
    if axis.has_data():
        axis.legend(fontsize=7, frameon=False, loc="lower right")
