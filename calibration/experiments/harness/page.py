"""What the pages of the studies have in common: their order, tables, what was not scored, what it cost."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.effects import COMPARED, Effect, Medians, count_agreements
from calibration.experiments.harness.published import source
from calibration.experiments.harness.rows import TIMES

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = [
    "Page",
    "by_setup",
    "cells_table",
    "cost_table",
    "directions_table",
    "effects_table",
    "fractions_of",
    "make_page",
    "medians_table",
    "only_scored",
    "paper_note",
    "percent",
    "refusals",
    "section",
    "seeds_of",
    "split_table",
    "table",
]

_SETUP = ["backbone", "mode", "split"]


@dataclass(frozen=True)
class Page:
    """One study's page: markdown that names its figures, and what draws each, by file name."""

    markdown: str
    figures: Mapping[str, Callable[[], "Figure"]] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The page as it is written: its title, what kind of page it is, and the rest."""
        title, _, rest = self.markdown.partition("\n\n")
        return f"{title}\n\nA reference, printed from rows by `gelgate lab report`.\n\n{rest}"


def make_page(
    rows: "pd.DataFrame",
    condition: str,
    head: str,
    setup: Callable[["pd.DataFrame"], Iterable[str]],
    draw: Callable[["pd.DataFrame"], "Figure"] | None = None,
    name: Callable[[Any], str] = str,
) -> Page:
    """Make the page of a study: head and cells, every setup with its figure, both splits, refusals and cost.

    rows: of the study. condition: the column that it varies. setup: what is said of one backbone, mode and split. name:
    of a value of the condition.
    """
    scored, figures = only_scored(rows), dict[str, Callable[[], "Figure"]]()
    sections = [head, cells_table(rows, condition)]
    for title, group in by_setup(scored):
        sections.append("\n".join([f"## {title}\n", *setup(group)]))
        if draw is not None:
            words = [str(group[column].iloc[0]) for column in ("study", *_SETUP)]
            file = re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(words)) + ".svg"
            figures[file] = partial(draw, group)
            sections.append(f"![{title}]({file})\n")
    sections += [split_table(scored, condition), refusals(rows), cost_table(scored, condition, name)]
    return Page("\n".join(section for section in sections if section), figures)


def percent(share: float) -> str:
    """Write a share."""
    return f"{100 * share:g} %"


def table(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A markdown table."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def section(text: str, heading: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """Write a table below its text; nothing without a line."""
    return f"{text}\n\n{table(heading, lines)}" if lines else ""


def only_scored(rows: "pd.DataFrame") -> "pd.DataFrame":
    """Leave out the cells that were refused."""
    return rows[rows["error"].isna()] if "error" in rows else rows


def by_setup(rows: "pd.DataFrame") -> Iterator[tuple[str, "pd.DataFrame"]]:
    """The rows of each backbone, mode and split, with a heading; weights that are random are called so."""
    for (backbone, mode, split), group in rows.groupby(_SETUP):
        weights = set(group["weights"].dropna()) if "weights" in group else set()
        said = f" ({', '.join(sorted(weights))})" if weights else ""
        yield f"{backbone}{said}, {mode} mode, split by {split}", group


def cells_table(rows: "pd.DataFrame", condition: str) -> str:
    """Which cells the rows have, by part and setup. condition: the column that the study varies."""
    lines = [
        [
            part,
            backbone,
            mode,
            split,
            ", ".join(sorted(set(group["method"]))),
            ", ".join(_write_values(group[condition].dropna().unique())),
            seeds_of(group, condition),
            len(group),
        ]
        for (part, backbone, mode, split), group in rows.groupby(["part", *_SETUP])
    ]
    heading = ["part", "backbone", "mode", "split", "methods", condition.replace("_", " "), "seeds", "cells"]
    return f"**Cells.** What was computed, and what this page is made from:\n\n{table(heading, lines)}"


def seeds_of(rows: "pd.DataFrame", condition: str) -> str:
    """Write how many seeds the conditions have: `10`, or `1 to 3` where not all have as many."""
    counts = rows.groupby(["part", *_SETUP, "method", condition])["seed"].nunique()
    return f"{counts.min()}" if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"


def _write_values(values: Iterable[Any]) -> list[str]:
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in sorted(values)]


def fractions_of(rows: "pd.DataFrame") -> str:
    """Write the share of the presses that each method learns from."""
    return ", ".join(f"{method} {percent(own['fraction'].max())}" for method, own in rows.groupby("method"))


def paper_note() -> str:
    """Say what the numbers in brackets are."""
    return (
        f"In brackets: the paper's median ({source()}). It pressed real parts and had Wide-ResNet-50-2 with ImageNet "
        "weights, so orders and directions can be compared, and levels cannot.\n"
    )


def medians_table(
    ours: Medians, paper: Medians, measure: str, conditions: Sequence[tuple[str, str, str]]
) -> str:
    """Medians over seeds of one measure. conditions: their names in our rows, in the paper's data, and on the page."""
    pairs = sorted({(method, part) for method, part, name in ours if name == measure}, key=lambda p: p[::-1])
    lines = []
    for method, part in pairs:
        own, theirs = ours[method, part, measure], paper.get((method, part, measure), {})
        lines.append([method, part, *(_both(own.get(a), theirs.get(b)) for a, b, _ in conditions)])
    return table(
        [COMPARED[measure.removesuffix("_common")], "part", *(title for _, _, title in conditions)], lines
    )


def _both(ours: float | None, paper: float | None) -> str:
    text = "-" if ours is None else f"{ours:.4f}"
    return text if paper is None else f"{text} ({paper:.4f})"


def effects_table(found: Sequence[Effect], title: str) -> str:
    """Directions of an effect, ours and the paper's, with their counts."""
    return f"{title}: {count_agreements(effect.agreement for effect in found)}.\n\n{directions_table(found)}"


def directions_table(found: Sequence[Effect]) -> str:
    """Write the directions without title and counts."""
    lines = [
        [
            e.method,
            e.part,
            COMPARED[e.measure],
            f"{e.difference:+.4f}",
            e.ours,
            e.paper or "-",
            e.agreement or "-",
        ]
        for e in found
    ]
    heading = ["method", "part", "measure", "mean difference", "here", "paper", "direction"]
    return table(heading, lines)


def split_table(rows: "pd.DataFrame", condition: str, measure: str = "aupro_001") -> str:
    """Write how much higher a measure is if presses, not specimens, are held out; empty without rows of both splits.

    condition: the column that the study varies. Only cells that both splits have are compared.
    """
    keys = ["backbone", "mode", "method", "part"]
    by = rows.pivot_table(measure, [*keys, condition, "seed"], "split", aggfunc="mean")
    if set(by) != {"press", "specimen"} or (both := by.dropna()).empty:
        return ""
    lines = [
        [
            *names,
            len(pairs),
            *(f"{pairs[split].mean():.4f}" for split in ("press", "specimen")),
            f"{(pairs['press'] - pairs['specimen']).mean():+.4f}",
        ]
        for names, pairs in both.groupby(level=keys)
    ]
    heading = ["backbone", "mode", "method", "part", "cells of each", "by press", "by specimen", "difference"]
    return (
        f"## Split by press and by specimen\n\nMean {COMPARED[measure]} over the conditions and seeds that both splits "
        "have. In a split by press, other presses of a tested specimen are in the bank.\n\n"
        f"{table(heading, lines)}"
    )


def refusals(rows: "pd.DataFrame") -> str:
    """List what was not scored, and why; empty where every cell was."""
    if "error" not in rows or rows["error"].isna().all():
        return ""
    bad = rows[rows["error"].notna()]
    lines = [
        [method, mode, backbone, len(group), sentence]
        for (method, mode, backbone, sentence), group in bad.groupby(["method", "mode", "backbone", "error"])
    ]
    return f"## Not scored\n\n{table(['method', 'mode', 'backbone', 'cells', 'why'], lines)}"


def cost_table(rows: "pd.DataFrame", condition: str, name: Callable[[Any], str] = str) -> str:
    """Median processor seconds of a cell by its stages, and the bank, for each condition and method."""
    lines, stages = [], list(TIMES)
    for (value, method), group in rows.groupby([condition, "method"]):
        seconds = [f"{group[stage].median():.2f}" for stage in stages]
        bank = f"{group['bank_bytes'].median() / 1e6:.1f}"
        lines.append([name(value), method, len(group), int(group["presses"].median()), *seconds, bank])
    heading = [condition, "method", "cells", "presses", "fit s", "score s", "measures s", "bank MB"]
    minutes = round(sum(rows[stage].sum() for stage in stages) / 60)
    return (
        f"## Cost\n\nProcessor seconds, medians per cell; the {len(rows)} cells of this table took "
        f"{minutes} minute{'s' * (minutes != 1)} of one core.\n\n{table(heading, lines)}"
    )
