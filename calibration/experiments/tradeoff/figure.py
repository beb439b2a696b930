"""The picture of a run: accuracy against milliseconds, the front marked and named. Made from rows alone."""

import argparse
import io
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calibration.experiments.tradeoff.machine import busy
from calibration.experiments.tradeoff.page import FIRST, METHOD_NAMES
from calibration.experiments.tradeoff.rows import Row, read_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "list_front", "name_point", "svg"]

COLOURS: Final = ("#2f6db3", "#c8621f", "#27876a", "#8257ab", "#b93a5b", "#86751c", "#5d6a75", "#1f8ea3")
PEER = "X"
_MOST_IN_A_ROW = 10
INK, SOFT, GRID = "#22272b", "#626a70", "#eceae4"

STYLE: Final[dict[Any, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.edgecolor": "#c9c6bd",
    "axes.labelcolor": SOFT,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "svg.fonttype": "path",
    "svg.hashsalt": "gelgate",
}


def svg(rows: Sequence[Row]) -> bytes:
    """The picture as SVG bytes; equal rows give equal bytes."""
    import matplotlib as mpl

    stream = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure(rows).savefig(stream, format="svg", metadata={"Date": None, "Creator": "gelgate lab tradeoff"})
    return stream.getvalue()


def figure(rows: Sequence[Row]) -> "Figure":
    """Draw accuracy (AU-PRO) against the milliseconds of a press, as a matplotlib figure without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = [row for row in rows if row["accuracy"][FIRST]["value"] is not None]
    made = Figure(figsize=(9, 5.2), facecolor="white")
    FigureCanvasAgg(made)
    axes = made.add_axes((0.075, 0.165, 0.9, 0.725))
    _frame(axes, drawn)
    methods = list(dict.fromkeys(row["method"] for row in drawn))
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(methods)}
    for row in drawn:
        _mark(axes, row, colours[row["method"]])
    _front(axes, drawn)
    _legend(axes, colours, {row["method"] for row in drawn if row.get("peer")})
    first, machine = rows[0], rows[0]["machine"]
    made.text(0.075, 0.945, "What accuracy costs", fontsize=13, fontweight="bold", color=INK)
    subtitle = (
        f"{len(drawn)} operating points on {first['part']}/{first['position']}, scored on pieces that no fit has seen; "
        f"{machine['processor']}, {machine['threads']} threads"
    )
    made.text(0.075, 0.908, subtitle, fontsize=8.5, color=SOFT)
    made.text(0.975, 0.945, busy(machine), fontsize=8.5, color=COLOURS[1], ha="right")
    return made


def _frame(axes: "Axes", rows: Sequence[Row]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.set_axisbelow(True)
    axes.grid(color=GRID, linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("milliseconds per press, camera bytes to published picture")
    axes.set_ylabel("AU-PRO up to 1 % false positives")
    axes.set_xlim(min(row["ms"]["low"] for row in rows) * 0.9, max(row["ms"]["high"] for row in rows) * 1.15)
    values = [row["accuracy"][FIRST]["value"] for row in rows]
    room = 0.06 * max(max(values) - min(values), 0.02)
    axes.set_ylim(min(values) - room, max(values) + 3 * room)
    axes.xaxis.set_major_locator(LogLocator(base=10, subs=(1, 1.5, 2, 3, 4, 5, 7)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _mark(axes: "Axes", row: Row, colour: str) -> None:
    is_hollow = row["work"]["int8"] > 0
    axes.scatter(
        row["ms"]["median"],
        row["accuracy"][FIRST]["value"],
        s=14 + 1.6 * row["presses"],
        marker=PEER if row.get("peer") else {"lr": "o", "hr": "s"}.get(row["view"], "D"),
        facecolors="white" if is_hollow else colour,
        edgecolors=colour if is_hollow else "white",
        linewidths=1.3 if is_hollow else 0.7,
        alpha=1.0 if row["is_on_front"] else 0.4,
        zorder=4 if row["is_on_front"] else 3,
    )


def _front(axes: "Axes", rows: Sequence[Row]) -> None:
    """Draw the stairs of what is reached in a time, and each point of the front with its name and interval."""
    front = list_front(rows)
    times = [row["ms"]["median"] for row in front]
    values = [row["accuracy"][FIRST]["value"] for row in front]
    best = np.maximum.accumulate(values)
    axes.step(
        [*times, axes.get_xlim()[1]], [*best, best[-1]], where="post", color=INK, linewidth=1.1, zorder=2
    )
    for k, (row, time, value) in enumerate(zip(front, times, values, strict=True)):
        span = [row["ms"]["low"], row["ms"]["high"]]
        axes.plot(span, [value, value], color=INK, linewidth=0.8, alpha=0.5, zorder=3)
        axes.annotate(
            name_point(row),
            (time, value),
            xytext=(0, 13 if k % 2 else 26),
            textcoords="offset points",
            ha="left" if time**2 < math.prod(axes.get_xlim()) else "right",
            arrowprops={"arrowstyle": "-", "color": SOFT, "linewidth": 0.5},
            fontsize=7.5,
            color=INK,
            zorder=5,
        )


def list_front(rows: Sequence[Row]) -> list[Row]:
    """Return the points of the front, the fastest first."""
    return sorted((row for row in rows if row["is_on_front"]), key=lambda row: float(row["ms"]["median"]))


def name_point(row: Row) -> str:
    """A point for people: method, precision, settings, and the view where it is not the usual one."""
    precision = "int8" if row["work"]["int8"] > 0 else "float32"
    words = [f"{METHOD_NAMES.get(row['method'], row['method'])} {precision}"]
    words += [f"{name} {value}" for name, value in row["settings"].items()]
    return ", ".join(
        words
        if row["view"] == "lr"
        else [*words, "in tiles" if "tiles" in row["view"] else "high resolution"]
    )


def _legend(axes: "Axes", colours: Mapping[str, str], peers: Collection[str]) -> None:
    marks = [
        (METHOD_NAMES.get(name, name), PEER if name in peers else "o", colour, colour)
        for name, colour in colours.items()
    ]
    marks += [
        ("int8 trunk", "o", "white", SOFT),
        ("high resolution", "s", SOFT, SOFT),
        ("in tiles", "D", SOFT, SOFT),
    ]
    for label, marker, face, edge in marks:
        axes.plot([], [], ls="", marker=marker, mfc=face, mec=edge, ms=6, label=label)
    axes.plot([], [], color=INK, linewidth=1.1, label="front")
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.115),
        frameon=False,
        fontsize=7.5,
        ncols=math.ceil((len(marks) + 1) / (1 if len(marks) < _MOST_IN_A_ROW else 2)),
        columnspacing=1.3,
        handletextpad=0.3,
    )


if __name__ == "__main__":
    given = argparse.ArgumentParser(description="Draw the rows of a run.")
    given.add_argument("rows", type=Path)
    given.add_argument("picture", type=Path)
    paths = given.parse_args()
    paths.picture.write_bytes(svg(read_rows(paths.rows)))
