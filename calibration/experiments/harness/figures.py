"""Figures of the studies, as matplotlib figures and as SVG text that is the same in every run."""

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.intervals import is_drawn, mean_interval
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Curve",
    "conditions_figure",
    "curves",
    "fraction_figure",
    "gel_share",
    "overview_figure",
    "shares_figure",
    "shots_figure",
    "svg",
]

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


@dataclass(frozen=True)
class Curve:
    """One method on one part."""

    part: str
    method: str
    x: NDArray[np.float64]
    """The fractions or shots, rising, (m,)."""
    values: tuple[NDArray[np.float64], ...]
    """Each seed's, a row per x."""
    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    """Of the 95 % interval of the mean over seeds, (m,), as `high`; nan where too few presses were drawn for one."""
    high: NDArray[np.float64]
    presses: NDArray[np.int64]
    """Nominal presses at each x, (m,)."""


def curves(rows: "pd.DataFrame", x: str, measure: str) -> Iterator[Curve]:
    """Compute the curves of one backbone, mode and split. x: the column that varies, such as `fraction`."""
    if x not in rows or measure not in rows:
        return
    for (part, method), group in rows.dropna(subset=[x, measure]).groupby(["part", "method"]):
        at = list(group.groupby(x))
        values = tuple(cell[measure].to_numpy(np.float64) for _, cell in at)
        spans = [_interval(cell, each) for (_, cell), each in zip(at, values, strict=True)]
        yield Curve(
            part,
            method,
            np.array([float(value) for value, _ in at]),
            values,
            np.array([each.mean() for each in values]),
            np.array([low for low, _ in spans]),
            np.array([high for _, high in spans]),
            np.array([int(cell["presses"].max()) for _, cell in at]),
        )


def _interval(cell: "pd.DataFrame", values: NDArray[np.float64]) -> tuple[float, float]:
    """The interval of the mean over the seeds of a cell; nan where they learn the same presses."""
    if not any(is_drawn(row) for row in cell.to_dict("records")):
        return math.nan, math.nan
    return mean_interval(values)


def gel_share(presses: float) -> float:
    """Return the part of a gel's rated life that this number of presses uses, 1 is all of it."""
    return presses / DEFAULT_LIMIT_PRESSES


def overview_figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """Draw a panel per method, a line per part, against the fraction. rows: of one backbone, mode and split."""
    return shares_figure(rows, "fraction", _SHARE, measure, panel="method", with_dots=False)


def fraction_figure(rows: "pd.DataFrame", part: str, measure: str = "aupro_001") -> "Figure":
    """Draw all methods on one part, every seed a dot, against the fraction, the presses and the gel that they use."""
    own = rows[rows["part"] == part]
    figure = shares_figure(own, "fraction", _SHARE, measure)
    pool = max((float(c.presses[-1] / c.x[-1]) for c in curves(own, "fraction", measure)), default=0.0)
    if pool:
        above = figure.axes[0].secondary_xaxis(
            "top", functions=(partial(np.multiply, pool / 100), partial(np.multiply, 100 / pool))
        )
        above.set_xlabel(
            f"presses; all {pool:.0f} are {100 * gel_share(pool):.0f} % of a gel's rated life", fontsize=8
        )
        above.tick_params(labelsize=7)
    return figure


def shots_figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """Draw a panel per part, a line per method, against the number of presses on a logarithmic axis."""
    figure = shares_figure(rows, "shots", "nominal presses", measure, scale=1)
    for axis in figure.axes:
        if axis.has_data():
            axis.set_xscale("log", base=2)
            own = rows[(rows["part"] == axis.get_title(loc="left")) & rows[measure].notna()]
            shots = sorted(own["shots"].dropna().unique())
            axis.set_xticks(shots, [f"{x:g}" for x in shots])
    return figure


def shares_figure(
    rows: "pd.DataFrame",
    x: str,
    label: str,
    measure: str = "aupro_001",
    *,
    panel: str = "part",
    scale: float = 100,
    with_dots: bool = True,
) -> "Figure":
    """Draw a panel per part, a line per method, against a share that may be zero.

    x: the column of shares. panel: `part` or `method`, the other one has the lines. scale: of x.
    """
    line = attrgetter("method" if panel == "part" else "part")
    every = sorted(curves(rows, x, measure), key=lambda curve: (getattr(curve, panel), line(curve)))
    panels = [(name, list(group)) for name, group in groupby(every, attrgetter(panel))]
    figure, axes = _panels(len(panels))
    names = sorted({line(curve) for curve in every})
    colours = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(names)}
    for axis, (name, group) in zip(axes, panels, strict=False):
        for curve in group:
            _line(axis, curve, scale * curve.x, line(curve), colours[line(curve)], with_dots=with_dots)
        _label(axis, name, label, measure)
    return figure


def conditions_figure(
    rows: "pd.DataFrame", column: str, order: Sequence[str], measure: str, title: str
) -> "Figure":
    """Draw a panel per part, a line per method, over named conditions in an order."""
    placed = rows.assign(place=[order.index(name) for name in rows[column]])
    figure = shares_figure(placed, "place", "", measure, scale=1)
    for axis in figure.axes:
        if axis.has_data():
            axis.set_xticks(range(len(order)), list(order))
            axis.set_ylabel(title, fontsize=8)
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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(3, max(1, count))
    rows = max(1, -(-count // columns))
    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for spare in axes[max(1, count) :]:
        spare.set_axis_off()
    return figure, list(axes[: max(1, count)])


def _line(
    axis: "Axes", curve: Curve, x: NDArray[np.float64], name: str, colour: str, *, with_dots: bool = True
) -> None:
    """The mean, its interval as a band, and a dot for each seed."""
    axis.plot(x, curve.mean, color=colour, label=name, linewidth=1.3)
    axis.fill_between(x, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)
    if with_dots:
        xs = [at for at, each in zip(x, curve.values, strict=True) for _ in each]
        ys = [value for each in curve.values for value in each]
        axis.plot(xs, ys, ".", color=colour, markersize=2.5, alpha=0.6)


def _label(axis: "Axes", title: str, x: str, measure: str) -> None:
    axis.set_title(title, fontsize=9, loc="left")
    axis.set_xlabel(x, fontsize=8)
    axis.set_ylabel(_MEASURE_NAMES.get(measure, measure), fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, linewidth=0.5)
    if axis.has_data():
        axis.legend(fontsize=7, frameon=False, loc="lower right")
