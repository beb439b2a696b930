"""What the pages of the studies have in common: setups, tables, what was not scored."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.evidence import COMPARED, are_drawn, count_agreements, spread_measures
from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.published import paper_medians, read_published
from calibration.experiments.harness.rows import TIMES

if TYPE_CHECKING:
    import pandas as pd
    from jinja2 import Environment
    from matplotlib.figure import Figure

__all__ = [
    "SETUP",
    "Figures",
    "Page",
    "by_setup",
    "figure_file",
    "make_page",
    "only_scored",
    "percent",
    "render",
    "share_of",
    "table",
    "tabulate_medians",
]

SETUP = ["backbone", "mode", "split"]

Figures = Mapping[str, Callable[[], "Figure"]]
"""What draws each figure, by its file name."""


@dataclass(frozen=True)
class Page:
    """One study's page."""

    text: str
    """Markdown that names the figures."""
    figures: Figures = field(default_factory=dict)


def render(template: str, **values: Any) -> str:
    """Return a page from a template of `studies/pages`, with one empty line between its blocks."""
    text = _templates().get_template(f"{template}.md.jinja").render(values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


@cache
def _templates() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("calibration.experiments", "studies/pages")
    made = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters |= {"table": table, "percent": percent}
    made.filters |= {"count_agreements": count_agreements, "spread_measures": spread_measures}
    made.globals |= {"source": read_published()["source"], "compared": COMPARED}
    return made


def make_page(
    study: str,
    rows: "pd.DataFrame",
    condition: str,
    describe: Callable[["pd.DataFrame"], Mapping[str, Any]],
    draw: Callable[["pd.DataFrame"], Figures] = lambda rows: {},
    **more: Any,
) -> Page:
    """Make the page of a study from its template: every setup with its figures, both splits, refusals.

    rows: of the study. condition: the column that it varies. describe: the template's values for one backbone, mode and
    split. more: further values.
    """
    scored, figures, setups = only_scored(rows), dict[str, Callable[[], "Figure"]](), []
    for title, group in by_setup(scored):
        drawn = draw(group)
        figures |= drawn
        setups.append({"title": title, "figures": list(drawn), **describe(group)})
    keys = ["method", "mode", "backbone"]
    refused = rows.reindex(columns=[*keys, "error"]).dropna().groupby([*keys, "error"]).size()
    values = {
        "rows": rows,
        "parts": ", ".join(sorted(rows["part"].unique())),
        "seeds": _count_seeds(rows, condition),
        "weights": rows.reindex(columns=["backbone", "weights"]).dropna().drop_duplicates(),
        "setups": setups,
        "splits": compare_splits(scored, condition),
        "refused": refused.reset_index(name="cells")[[*keys, "cells", "error"]],
        "minutes": round(scored[list(TIMES)].sum().sum() / 60),
        "timed": len(scored),
    }
    return Page(render(study, **(values | more)), figures)


def percent(share: float) -> str:
    """Write a share."""
    return f"{100 * share:g} %"


def table(lines: "pd.DataFrame") -> str:
    """Return a frame as a markdown table, without its index."""
    return markdown_table(list(map(str, lines.columns)), lines.itertuples(index=False))


def only_scored(rows: "pd.DataFrame") -> "pd.DataFrame":
    """Leave out the cells that were refused."""
    return rows[rows["error"].isna()] if "error" in rows else rows


def by_setup(rows: "pd.DataFrame") -> Iterator[tuple[str, "pd.DataFrame"]]:
    """Give the rows of each backbone, mode and split, with a heading."""
    for (backbone, mode, split), group in rows.assign(drawn=are_drawn(rows)).groupby(SETUP):
        yield f"{backbone}, {mode} mode, split by {split}", group


def figure_file(rows: "pd.DataFrame", *more: str) -> str:
    """Return the file name of a figure of one study and setup."""
    words = [str(rows[column].iloc[0]) for column in ("study", *SETUP)]
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join([*words, *more])) + ".svg"


def _count_seeds(rows: "pd.DataFrame", condition: str) -> str:
    """Write how many seeds the conditions have: `10`, or `1 to 3` where not all have as many."""
    counts = rows.groupby(["part", *SETUP, "method", condition])["seed"].nunique()
    return f"{counts.min()}" if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"


def share_of(rows: "pd.DataFrame") -> str:
    """Write the share of the presses that each method learns from."""
    shares = rows.groupby("method")["fraction"].max()
    return ", ".join(f"{method} {percent(share)}" for method, share in shares.items())


def tabulate_medians(
    rows: "pd.DataFrame",
    condition: str,
    names: Mapping[Any, str],
    measure: str = "aupro_001",
    published: Mapping[Any, str] = {},
) -> "pd.DataFrame":
    """Return the medians of a measure over seeds, the paper's in brackets.

    rows: of one study and setup. names: the values of the condition, as they are printed. published: what the paper's
    data call them.
    """
    paper = paper_medians(str(rows["study"].iloc[0]))
    medians = rows.pivot_table(measure, ["part", "method"], condition, aggfunc="median")
    medians_table = medians.index.to_frame(index=False)[["method", "part"]]
    for value, heading in names.items():
        name = published.get(value, "")
        theirs = [paper.get((method, part, measure), {}).get(name) for part, method in medians.index]
        medians_table[heading] = list(map(_both, medians.get(value, [None] * len(medians_table)), theirs))
    return medians_table.rename(columns={"method": COMPARED[measure.removesuffix("_common")]})


def _both(ours: float | None, paper: float | None) -> str:
    text = "-" if ours is None or ours != ours else f"{ours:.4f}"
    return text if paper is None else f"{text} ({paper:.4f})"


def compare_splits(rows: "pd.DataFrame", condition: str) -> "pd.DataFrame | None":
    """Return how much higher AU-PRO is if presses, not specimens, are held out; None without rows of both splits.

    condition: the column that the study varies. Only cells that both splits have are compared.
    """
    keys = ["backbone", "mode", "method", "part"]
    by = rows.pivot_table("aupro_001", [*keys, condition, "seed"], "split", aggfunc="mean")
    if set(by) != {"press", "specimen"} or (both := by.dropna()).empty:
        return None
    comparison = both.groupby(level=keys).mean()
    comparison.insert(0, "cells of each", both.groupby(level=keys).size())
    comparison["difference"] = [f"{value:+.4f}" for value in comparison["press"] - comparison["specimen"]]
    for split in ("press", "specimen"):
        comparison[split] = comparison[split].map("{:.4f}".format)
    return comparison.rename(columns={"press": "by press", "specimen": "by specimen"}).reset_index()
