"""What the studies take: the processor time of their cells, by study, setup and part, from the rows' own seconds."""

from typing import TYPE_CHECKING

from calibration.experiments.harness.page import Page, only_scored, table
from calibration.experiments.harness.rows import TIMES

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]

SEEDS = 10
"""Of a complete study, as in the paper."""

_SETUP = ["backbone", "mode", "split"]
_CONDITIONS = ("method", "fraction", "shots", "target_fraction", "view", "most_presses", "bad")


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of all studies."""
    scored = only_scored(rows)
    seconds = scored.reindex(columns=list(TIMES)).sum(axis=1, skipna=False)
    timed = scored.assign(seconds=seconds).dropna(subset=["seconds"])
    return Page(
        "# What the studies take\n\nProcessor time of fitting, scoring and measuring, as each cell's row has it. "
        "Extraction of features, which is done once, is not in it. On a machine that does other work as well it is "
        "longer; with `--jobs N` on N free cores the clock shows about an Nth of it. Dearer studies were run at a "
        f"reduced size: the last column is what {SEEDS} seeds of the same conditions take.\n\n"
        f"{_by_setup(timed)}\n## Part by part\n\n{_by_part(timed)}"
    )


def _by_setup(timed: "pd.DataFrame") -> str:
    """Every study of a setup, and all of them together."""
    lines = []
    for setup, group in timed.groupby(_SETUP):
        lines += [[*setup, study, *_summarise(own)] for study, own in group.groupby("study")]
        lines.append([*setup, "**all**", *_summarise(group)])
    return table([*_SETUP, "study", *_HEADING], lines)


def _by_part(timed: "pd.DataFrame") -> str:
    keys = ["study", "part", *_SETUP]
    return table([*keys, *_HEADING], [[*names, *_summarise(group)] for names, group in timed.groupby(keys)])


_HEADING = ["cells", "seconds of a cell, median", "minutes of one core", f"with {SEEDS} seeds"]


def _summarise(timed: "pd.DataFrame") -> list[str]:
    conditions = [name for name in ("study", "part", *_CONDITIONS) if name in timed]
    complete = SEEDS * timed.groupby(conditions, dropna=False)["seconds"].mean().sum()
    return [
        str(len(timed)),
        f"{timed['seconds'].median():.1f}",
        f"{timed['seconds'].sum() / 60:.1f}",
        f"{complete / 60:.1f}",
    ]
