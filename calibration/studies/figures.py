"""Figures of the good-fraction study, as matplotlib figures and as SVG text that is the same in every run."""

import io
from collections.abc import Sequence
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.studies.curves import MEASURE_NAMES, Curve, curves, gel_share

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "conditions_figure",
    "fraction_figure",
    "overview_figure",
    "shares_figure",
    "shots_figure",
    "svg",
]

# Okabe and Ito's palette: readers with any kind of colour vision can distinguish it.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

_PANEL = (4.2, 3.1)  # inches


def overview_figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """A panel per method, a line per part, against the fraction. rows: of one backbone, mode and split."""
    every = sorted(curves(rows, "fraction", measure), key=lambda c: (c.method, c.part))
    panels = [(method, list(group)) for method, group in groupby(every, lambda c: c.method)]
    figure, axes = _panels(len(panels))
    colours = _coloured(sorted({c.part for c in every}))
    for axis, (method, group) in zip(axes, panels, strict=True):
        for curve in group:
            _line(axis, curve, 100 * curve.x, curve.part, colours[curve.part], with_dots=False)
        _label(axis, method, "share of the nominal presses, %", measure)
    return figure


def fraction_figure(rows: "pd.DataFrame", part: str, measure: str = "aupro_001") -> "Figure":
    """All methods on one part, every seed a dot, against the fraction, the presses and the gel that they use."""
    found = sorted(curves(rows[rows["part"] == part], "fraction", measure), key=lambda c: c.method)
    figure, (axis,) = _panels(1)
    colours = _coloured([c.method for c in found])
    for curve in found:
        _line(axis, curve, 100 * curve.x, curve.method, colours[curve.method])
    _label(axis, part, "share of the nominal presses, %", measure)
    pool = max((float(c.presses[-1] / c.x[-1]) for c in found), default=0.0)
    if pool:
        above = axis.secondary_xaxis(
            "top", functions=(partial(_scaled, by=pool / 100), partial(_scaled, by=100 / pool))
        )
        above.set_xlabel(
            f"presses; all {pool:.0f} are {100 * gel_share(pool):.0f} % of a gel's rated life", fontsize=8
        )
        above.tick_params(labelsize=7)
    return figure


def shots_figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """A panel per part, a line per method, against the number of presses on a logarithmic axis."""
    every = sorted(curves(rows, "shots", measure), key=lambda c: (c.part, c.method))
    panels = [(part, list(group)) for part, group in groupby(every, lambda c: c.part)]
    figure, axes = _panels(len(panels))
    colours = _coloured(sorted({c.method for c in every}))
    for axis, (part, group) in zip(axes, panels, strict=True):
        for curve in group:
            _line(axis, curve, curve.x, curve.method, colours[curve.method])
        axis.set_xscale("log", base=2)
        shots = sorted({x for curve in group for x in curve.x})
        axis.set_xticks(shots, [f"{x:g}" for x in shots])
        _label(axis, part, "nominal presses", measure)
    return figure


def shares_figure(rows: "pd.DataFrame", x: str, label: str, measure: str = "aupro_001") -> "Figure":
    """A panel per part, a line per method, against a share that may be zero. x: the column of shares."""
    every = sorted(curves(rows, x, measure), key=lambda c: (c.part, c.method))
    panels = [(part, list(group)) for part, group in groupby(every, lambda c: c.part)]
    figure, axes = _panels(len(panels))
    colours = _coloured(sorted({c.method for c in every}))
    for axis, (part, group) in zip(axes, panels, strict=True):
        for curve in group:
            _line(axis, curve, 100 * curve.x, curve.method, colours[curve.method])
        _label(axis, part, label, measure)
    return figure


def conditions_figure(
    rows: "pd.DataFrame", column: str, order: Sequence[str], measure: str, title: str
) -> "Figure":
    """A panel per part, a line per method, over named conditions in an order."""
    placed = rows.assign(place=[order.index(name) for name in rows[column]])
    figure = shares_figure(placed.assign(place=placed["place"] / 100), "place", "", measure)
    for axis in figure.axes:
        if axis.has_data():
            axis.set_xticks(range(len(order)), list(order))
            axis.set_ylabel(title, fontsize=8)
    return figure


def svg(figure: "Figure") -> str:
    """The figure's SVG: no date, and identifiers that do not depend on the process."""
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


def _scaled(values: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    return values * by


def _coloured(names: Sequence[str]) -> dict[str, str]:
    return {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(names)}


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
    axis.set_ylabel(MEASURE_NAMES.get(measure, measure), fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, linewidth=0.5)
    if axis.has_data():
        axis.legend(fontsize=7, frameon=False, loc="lower right")
