"""The picture of a run: accuracy against what the line waits for, the front named. Made from rows alone.

Below it, in grey, what a press takes after its verdict, where a page of `gelgate lab bench` is given.
"""

import argparse
import io
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calibration.experiments.tradeoff.front import (
    Row,
    list_front,
    only_known,
    read_rows,
    value_of,
    verdict_ms,
)
from calibration.experiments.tradeoff.machine import busy
from calibration.fitting.trunks import DEFAULT_BACKBONE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "name_point", "say_cost", "svg"]

METHOD_NAMES: Final = {
    "padim": "PaDiM",
    "spade": "SPADE",
    "fapm": "FAPM",
    "inreach": "InReaCh",
    "patchcore": "PatchCore",
    "subspace": "PCA subspace",
    "anomalib_padim": "anomalib's PaDiM",
    "anomalib_patchcore": "anomalib's PatchCore",
}

MARKS: Final = {
    "padim": ("o", "#1f5fa8"),
    "patchcore": ("D", "#b93a5b"),
    "spade": ("s", "#c8621f"),
    "fapm": ("^", "#27876a"),
    "inreach": ("v", "#8257ab"),
    "subspace": ("P", "#86751c"),
}
PEER, OTHER = ("X", "#22272b"), ("*", "#5d6a75")
INK, SOFT, GRID, FLOOR, LATER_FILL = "#22272b", "#565d63", "#e4e2dc", "#e9e6df", "#cfcdc7"

NEAR: Final = 2.0
"""Points up to this many times the fastest one have a linear axis of their own: most differ by milliseconds."""

WIDTH_IN, LABEL_IN, PLOT_IN, BELOW_IN, LATER_IN = 5.2, 0.31, 2.35, 1.45, 0.86
"""At 400 pixels' width the letters are 9 pixels high."""

LATER: Final[Mapping[str, str]] = {
    "outbox": "result in the outbox",
    "subscriber": "result at a subscriber",
    "picture": "its picture there",
}
"""Stages after the verdict, for which the line does not wait."""

STYLE: Final[dict[Any, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.edgecolor": "#8d8b84",
    "axes.labelcolor": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "svg.fonttype": "path",
    "svg.hashsalt": "gelgate",
}

DARK: Final = (
    b"<style>@media (prefers-color-scheme: dark) { svg { filter: invert(0.92) hue-rotate(180deg); } }</style>"
)


def svg(rows: Sequence[Row], medians: Mapping[str, float] | None = None) -> bytes:
    """Return the picture as SVG bytes, dark where the reader's screen is; equal values give equal bytes."""
    import matplotlib as mpl

    stream = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure(rows, medians).savefig(
            stream, format="svg", metadata={"Date": None, "Creator": "gelgate lab tradeoff"}
        )
    return stream.getvalue().replace(b"<defs>", DARK + b"\n <defs>", 1)


def figure(rows: Sequence[Row], medians: Mapping[str, float] | None = None) -> "Figure":
    """Draw accuracy (AU-PRO) against the milliseconds to the verdict, as a matplotlib figure without a window.

    medians: milliseconds from the settled frame to the stages `verdict` and `LATER` of a station.
    """
    from matplotlib.figure import Figure

    drawn = only_known(rows)
    front = list_front(drawn)
    below = BELOW_IN + (LATER_IN if medians else 0)
    height = below + PLOT_IN + LABEL_IN * len(front) + 0.48
    made = Figure(figsize=(WIDTH_IN, height), facecolor="white")
    for axes in _panels(made, drawn, height, below):
        _floor(axes, drawn)
        steps = [(verdict_ms(row), value_of(row)) for row in front]
        axes.step(
            *zip(*steps, (1e9, steps[-1][1]), strict=True), where="post", color=INK, linewidth=1, zorder=2
        )
        for row in drawn:
            _mark(axes, row, row in front)
        for level, row in enumerate(reversed(front)):
            _name(axes, row, PLOT_IN + LABEL_IN * level)
        _name_best_peer(axes, drawn)
    _legend(made, drawn, height, below)
    if medians:
        _draw_later(made, medians, height)
    first, machine = rows[0], rows[0]["machine"]
    made.text(
        0.02, 1 - 0.2 / height, "What accuracy costs in time", fontsize=12, fontweight="bold", color=INK
    )
    subtitle = (
        f"{len(drawn)} operating points on {first['part']}/{first['position']}; {machine['processor']}, "
        f"{machine['threads']} threads. {busy(machine)}"
    )
    made.text(0.02, 1 - 0.4 / height, subtitle, fontsize=8, color=SOFT)
    made.text(0.02, 0.08 / height, textwrap.fill(say_cost(rows), 88), fontsize=7.9, color=INK, va="bottom")
    return made


def say_cost(rows: Sequence[Row]) -> str:
    """Return one sentence on what accuracy costs in time: the front, and the best peer."""
    front = list_front(rows)
    if not front:
        return "No point has an accuracy."
    parts = [f"AU-PRO {value_of(front[0]):.3f} takes {verdict_ms(front[0]):.0f} ms ({name_point(front[0])})"]
    for before, row in pairwise(front):
        more, ms = value_of(row) - value_of(before), verdict_ms(row) - verdict_ms(before)
        parts.append(f"{more:.3f} more takes {ms:.0f} ms more ({name_point(row)})")
    if peer := _best_peer(rows):
        parts.append(f"{name_point(peer)} has {value_of(peer):.3f} in {verdict_ms(peer):.0f} ms")
    return f"From the settled frame to the verdict, {'; '.join(parts)}."


def name_point(row: Row) -> str:
    """Name a point for people: method, precision, settings, and trunk and view where they are not the usual ones."""
    method = str(METHOD_NAMES.get(row["method"], row["method"]))
    if row.get("peer"):
        return method
    words = [f"{method} {'int8' if row['work']['int8'] > 0 else 'float32'}"]
    words += [f"{name} {value}" for name, value in row["settings"].items()]
    trunk = row["backbone"].removesuffix("_int8")
    words += [] if trunk == DEFAULT_BACKBONE else [f"on {trunk}"]
    views = [] if row["view"] == "lr" else ["in tiles" if "tiles" in row["view"] else "high resolution"]
    return ", ".join(words + views)


def _best_peer(rows: Sequence[Row]) -> Row | None:
    return max((row for row in only_known(rows) if row.get("peer")), key=value_of, default=None)


def _panels(made: "Figure", rows: Sequence[Row], height: float, below: float) -> list["Axes"]:
    """A linear panel of the fast points and, where there are slower ones, a logarithmic one beside it."""
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    times, values = [verdict_ms(row) for row in rows], [value_of(row) for row in rows]
    limit, room = NEAR * min(times), 0.04 * max(max(values) - min(values), 0.02)
    is_split = max(times) > limit
    bottom, tall = below / height, PLOT_IN / height
    panels = [made.add_axes((0.115, bottom, 0.555 if is_split else 0.865, tall))]
    panels[0].set_xlim(0, limit)
    if is_split:
        panels.append(made.add_axes((0.69, bottom, 0.29, tall), sharey=panels[0]))
        panels[1].set(xscale="log", xlim=(limit, 1.2 * max(times)))
        panels[1].tick_params(left=False, labelleft=False)
        panels[1].spines["left"].set(linestyle=(0, (2, 3)))
        ticks = [
            k * 10**power for power in range(7) for k in (1, 2, 3, 5) if limit < k * 10**power < max(times)
        ]
        panels[1].xaxis.set_major_locator(FixedLocator(ticks))
        panels[1].xaxis.set_major_formatter(ScalarFormatter())
        panels[1].xaxis.set_minor_formatter(NullFormatter())
    for axes in panels:
        axes.set_ylim(min(values) - room, max(values) + room)
        axes.set_axisbelow(True)
        axes.grid(color=GRID, linewidth=0.7)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("AU-PRO up to 1 % false positives", fontsize=8.5)
    made.text(
        0.55,
        bottom - 0.4 / height,
        "milliseconds from the settled frame to the verdict",
        ha="center",
        color=INK,
    )
    return panels


def _floor(axes: "Axes", rows: Sequence[Row]) -> None:
    """Shade what is faster than the bare trunk of the points that are as accurate."""
    ours = sorted((row for row in rows if not row.get("peer")), key=value_of)
    bottom, top = axes.get_ylim()
    levels = [bottom, *map(value_of, ours)]
    own = [float(row["stages"]["trunk"]["median"]) for row in ours]
    trunks = [min(own[k:]) for k in range(len(own))]
    axes.fill_betweenx(levels, [*trunks, trunks[-1]], color=FLOOR, step="post", zorder=0, linewidth=0)
    if axes.get_xlim()[0] == 0:
        axes.text(
            trunks[0] / 2,
            (bottom + top) / 2,
            "the trunk alone",
            rotation=90,
            ha="center",
            va="center",
            color=SOFT,
        )


def _mark(axes: "Axes", row: Row, is_on_front: bool) -> None:
    shape, colour = PEER if row.get("peer") else MARKS.get(row["method"], OTHER)
    axes.scatter(
        verdict_ms(row),
        value_of(row),
        s=52 if is_on_front else 22,
        marker=shape,
        facecolors="white" if row["work"]["int8"] > 0 else colour,
        edgecolors=INK if is_on_front else colour,
        linewidths=1.6 if is_on_front else 0.8,
        alpha=1.0 if is_on_front or row.get("peer") else 0.6,
        zorder=4 if is_on_front else 3,
    )


def _name(axes: "Axes", row: Row, up_in: float) -> None:
    """Write the name of a point of the front above the plot, in a line of its own, and lead from there to the mark."""
    (low, high), ms = axes.get_xlim(), verdict_ms(row)
    if not low < ms <= high:
        return
    is_late = low > 0 and ms**2 > low * high
    axes.annotate(
        f"{name_point(row)}\n{value_of(row):.3f} in {ms:.0f} ms",
        (ms, value_of(row)),
        xytext=(ms, 72 * up_in + 4),
        textcoords=("data", "axes points"),
        ha="right" if is_late else "left",
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.7, "relpos": (float(is_late), 0)},
        fontsize=8,
        linespacing=1.05,
        color=INK,
        annotation_clip=False,
    )


def _name_best_peer(axes: "Axes", rows: Sequence[Row]) -> None:
    peer, (low, high) = _best_peer(rows), axes.get_xlim()
    if peer is None or not low < verdict_ms(peer) <= high:
        return
    text = f"{name_point(peer)}\n{value_of(peer):.3f} in {verdict_ms(peer):.0f} ms"
    axes.annotate(
        text, (verdict_ms(peer), value_of(peer)), xytext=(0, -6), textcoords="offset points", fontsize=8, color=INK,
        ha="center", va="top",
    )  # fmt: skip


def _draw_later(made: "Figure", medians: Mapping[str, float], height: float) -> None:
    """Draw in grey when a press's result and picture arrive, from its verdict on."""
    axes = made.add_axes((0.115, 0.7 / height, 0.865, (LATER_IN - 0.3) / height))
    axes.set_axis_off()
    axes.set(xlim=(0, 1.75 * max(medians[name] for name in LATER)), ylim=(len(LATER) - 0.5, -0.5))
    start = medians["verdict"]
    axes.plot((start, start), (-0.5, len(LATER) - 0.5), color=SOFT, linewidth=1)
    for level, (name, text) in enumerate(LATER.items()):
        axes.barh(level, medians[name] - start, 0.6, start, color=LATER_FILL, edgecolor=SOFT, linewidth=0.6)
        axes.annotate(
            f"{text}: {medians[name]:.0f} ms", (medians[name], level), xytext=(4, 0), textcoords="offset points",
            va="center", fontsize=8, color=SOFT,
        )  # fmt: skip
    axes.annotate(
        f"verdict\n{start:.0f} ms", (start, 1), xytext=(-4, 0), textcoords="offset points", ha="right", va="center",
        fontsize=8, color=SOFT,
    )  # fmt: skip
    title = "Afterwards, at a running station, whatever the point: the line does not wait for it"
    made.text(0.02, (LATER_IN + 0.46) / height, title, fontsize=8, color=SOFT)


def _legend(made: "Figure", rows: Sequence[Row], height: float, below: float) -> None:
    from matplotlib.lines import Line2D

    present = dict.fromkeys(row["method"] for row in rows if not row.get("peer"))
    marks: list[tuple[str, str, str, str | None]] = [
        (METHOD_NAMES.get(name, name), *MARKS.get(name, OTHER), None) for name in present
    ]
    marks += [("int8 trunk", "o", SOFT, "white")]
    if _best_peer(rows):
        marks += [("other programs", *PEER, None)]
    entries = [
        Line2D([], [], ls="", marker=shape, color=colour, mfc=face or colour, ms=5, label=label)
        for label, shape, colour, face in marks
    ]
    made.legend(
        handles=entries,
        loc="center",
        bbox_to_anchor=(0.53, (below - 0.66) / height),
        frameon=False,
        fontsize=8,
        ncols=4,
        columnspacing=1.2,
        handletextpad=0.1,
    )


if __name__ == "__main__":
    from calibration.experiments.tradeoff.bench_command import read_medians  # a gateway and all that it loads

    given = argparse.ArgumentParser(description="Draw the rows of a run.")
    given.add_argument("rows", type=Path)
    given.add_argument("picture", type=Path)
    given.add_argument("--bench", type=Path, help="a page of `gelgate lab bench`")
    paths = given.parse_args()
    medians = read_medians(paths.bench.read_text(encoding="utf-8")) if paths.bench else None
    paths.picture.write_bytes(svg(read_rows(paths.rows), medians))
