"""What the studies take: the processor time of their cells, by study, setup and part, from the rows' own seconds."""

from typing import TYPE_CHECKING

from calibration.experiments.harness.page import SETUP, Page, only_scored, render
from calibration.experiments.harness.rows import TIMES

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]

SEEDS = 10
"""Of a complete study, as in the paper."""

_CONDITIONS = ("method", "fraction", "shots", "target_fraction", "view", "most_presses", "bad")


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of all studies."""
    import pandas as pd

    scored = only_scored(rows)
    seconds = scored.reindex(columns=list(TIMES)).sum(axis=1, skipna=False)
    timed = scored.assign(seconds=seconds).dropna(subset=["seconds"])
    totals = _summarise(timed, SETUP).assign(study="**all**")
    by_study = pd.concat([_summarise(timed, [*SETUP, "study"]), totals]).sort_values(SETUP, kind="stable")
    by_part = _summarise(timed, ["study", "part", *SETUP])
    return Page(render("time", seeds=SEEDS, by_study=by_study, by_part=by_part))


def _summarise(timed: "pd.DataFrame", keys: list[str]) -> "pd.DataFrame":
    """Return cells, the seconds of one, the minutes of all, and those of a complete study, for each group of rows."""
    groups = timed.groupby(keys)["seconds"]
    conditions = list(
        dict.fromkeys([*keys, "study", "part", *(name for name in _CONDITIONS if name in timed)])
    )
    complete = SEEDS * timed.groupby(conditions, dropna=False)["seconds"].mean()
    found = groups.agg(["size", "median", "sum"])
    found["complete"] = complete.groupby(level=keys).sum() / 60
    found["sum"] /= 60
    shown = found.astype({"size": int})
    for column in ("median", "sum", "complete"):
        shown[column] = shown[column].map("{:.1f}".format)
    heading = ["cells", "seconds of a cell, median", "minutes of one core", f"with {SEEDS} seeds"]
    return shown.set_axis(heading, axis=1).reset_index()
