"""The picture of a run: accuracy against milliseconds, the front marked and named. Made from rows alone."""

import argparse
import io
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calibration.experiments.tradeoff.machine import busy
from calibration.experiments.tradeoff.page import FIRST, METHOD_NAMES
from calibration.experiments.tradeoff.rows import Row, read_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "front_sentence", "svg"]

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
    """Accuracy (AU-PRO) against the milliseconds of a press, as a matplotlib figure without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = [row for row in rows if row["accuracy"][FIRST]["value"] is not None]
    made = Figure(figsize=(9, 5.2), facecolor="white")
    FigureCanvasAgg(made)
    axes = made.add_axes((0.075, 0.165, 0.9, 0.725))
    _frame(axes, drawn)
    methods = list(dict.fromkeys(row["method"] for row in drawn))
    for row in drawn:
        _mark(axes, row, COLOURS[methods.index(row["method"]) % len(COLOURS)])
    _front(axes, drawn)
    _legend(axes, methods, {row["method"] for row in drawn if row.get("peer")})
    first = rows[0]
    made.text(0.075, 0.945, "What accuracy costs", fontsize=13, fontweight="bold", color=INK)
    made.text(0.075, 0.908, _subtitle(first, len(drawn)), fontsize=8.5, color=SOFT)
    made.text(0.975, 0.945, busy(first["machine"]), fontsize=8.5, color=COLOURS[1], ha="right")
    return made


def _subtitle(first: Row, points: int) -> str:
    machine = first["machine"]
    return (
        f"{points} operating points on {first['part']}/{first['position']}, scored on pieces that no fit has seen; "
        f"{machine['processor']}, {machine['threads']} threads"
    )


def _frame(axes: "Axes", rows: Sequence[Row]) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter

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
    axes.xaxis.set_major_locator(_round_numbers())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _round_numbers() -> Any:
    from matplotlib.ticker import LogLocator

    return LogLocator(base=10, subs=(1, 1.5, 2, 3, 4, 5, 7))


def _stairs(pairs: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return those of (time, accuracy) that no faster one reaches, by rising time."""
    found: list[tuple[float, float]] = []
    for time, accuracy in sorted(pairs, key=lambda pair: (pair[0], -pair[1])):
        if not found or accuracy > found[-1][1]:
            found.append((time, accuracy))
    return found


def _mark(axes: "Axes", row: Row, colour: str) -> None:
    shape = PEER if row.get("peer") else {"lr": "o", "hr": "s"}.get(row["view"], "D")
    is_hollow = row["work"]["int8"] > 0
    axes.scatter(
        row["ms"]["median"],
        row["accuracy"][FIRST]["value"],
        s=14 + 1.6 * row["presses"],
        marker=shape,
        facecolors="white" if is_hollow else colour,
        edgecolors=colour if is_hollow else "white",
        linewidths=1.3 if is_hollow else 0.7,
        alpha=1.0 if row["is_on_front"] else 0.4,
        zorder=4 if row["is_on_front"] else 3,
    )


def _front(axes: "Axes", rows: Sequence[Row]) -> None:
    front = [row for row in rows if row["is_on_front"]]
    steps = _stairs([(row["ms"]["median"], row["accuracy"][FIRST]["value"]) for row in front])
    times = [time for time, _ in steps] + [axes.get_xlim()[1]]
    values = [value for _, value in steps] + [steps[-1][1]]
    axes.step(times, values, where="post", color=INK, linewidth=1.1, zorder=2)
    for k, row in enumerate(sorted(front, key=lambda row: row["ms"]["median"])):
        ms, accuracy = row["ms"], row["accuracy"][FIRST]["value"]
        axes.plot(
            [ms["low"], ms["high"]], [accuracy, accuracy], color=INK, linewidth=0.8, alpha=0.5, zorder=3
        )
        axes.annotate(
            _name(row),
            (ms["median"], accuracy),
            xytext=(0, 13 if k % 2 else 26),
            textcoords="offset points",
            ha="left" if ms["median"] ** 2 < math.prod(axes.get_xlim()) else "right",
            arrowprops={"arrowstyle": "-", "color": SOFT, "linewidth": 0.5},
            fontsize=7.5,
            color=INK,
            zorder=5,
        )


def _name(row: Row) -> str:
    """A point for people: method, precision, settings, and the view where it is not the usual one."""
    precision = "int8" if row["work"]["int8"] > 0 else "float32"
    words = [f"{METHOD_NAMES.get(row['method'], row['method'])} {precision}"]
    words += [f"{name} {value}" for name, value in row["settings"].items()]
    return ", ".join(
        words
        if row["view"] == "lr"
        else [*words, "in tiles" if "tiles" in row["view"] else "high resolution"]
    )


def front_sentence(rows: Sequence[Row]) -> str:
    """The points of the front, the fastest first, each with its accuracy and its milliseconds."""
    front = sorted((row for row in rows if row["is_on_front"]), key=lambda row: float(row["ms"]["median"]))
    listed = [
        f"{_name(row)}: {row['accuracy'][FIRST]['value']:.3f} in {row['ms']['median']:.0f} ms"
        for row in front
    ]
    return f"The front, by AU-PRO and time: {'; '.join(listed)}."


def _legend(axes: "Axes", methods: Sequence[str], peers: Collection[str]) -> None:
    from matplotlib.lines import Line2D

    def entry(label: str, marker: str, face: str, edge: str, size: float = 6) -> Line2D:
        return Line2D([], [], ls="", marker=marker, mfc=face, mec=edge, ms=size, label=label)

    entries = []
    for k, name in enumerate(methods):
        colour = COLOURS[k % len(COLOURS)]
        entries.append(entry(METHOD_NAMES.get(name, name), PEER if name in peers else "o", colour, colour))
    entries += [
        entry("int8 trunk", "o", "white", SOFT),
        entry("high resolution", "s", SOFT, SOFT),
        entry("in tiles", "D", SOFT, SOFT, 5),
        Line2D([], [], color=INK, linewidth=1.1, label="front"),
    ]
    axes.legend(
        handles=entries,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.115),
        frameon=False,
        fontsize=7.5,
        ncols=math.ceil(len(entries) / (2 if len(entries) > _MOST_IN_A_ROW else 1)),
        columnspacing=1.3,
        handletextpad=0.3,
    )


if __name__ == "__main__":
    given = argparse.ArgumentParser(description="Draw the rows of a run.")
    given.add_argument("rows", type=Path)
    given.add_argument("picture", type=Path)
    paths = given.parse_args()
    paths.picture.write_bytes(svg(read_rows(paths.rows)))
