"""Prints what the place of the part costs each method: the same part and damage, in a fixture and placed by hand.

`python docs/placement_page.py docs/studies` prints the page of docs/studies/placement: two folders of rows of the
good-fraction study, `fixture` and `by_hand`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.experiments.harness.evidence import mean_interval
from calibration.experiments.harness.page import table
from calibration.experiments.harness.rows import frame

PAGE = """\
# What the place of the part costs

A reference, printed from rows by `python docs/placement_page.py`.

{parts}, {presses} nominal presses, {seeds} seeds, AU-PRO@0.01: mean [95 % interval over seeds]. Both columns have the \
same kinds of damage and every other effect; *by hand* is the scene as it is, *fixture* is without `pose_jitter`.

{lines}"""


def page(fixture: pd.DataFrame, by_hand: pd.DataFrame) -> str:
    """Make the page, from the rows of both."""
    keys = ["backbone", "method"]
    held, placed = (rows.groupby(keys)["aupro_001"] for rows in (fixture, by_hand))
    comparison = held.agg(_write_span).to_frame("fixture")
    comparison["by hand"] = placed.agg(_write_span)
    comparison["difference"] = (placed.mean() - held.mean()).map("{:+.3f}".format)
    return PAGE.format(
        parts=", ".join(sorted(by_hand["part"].unique())),
        presses=by_hand["presses"].max(),
        seeds=by_hand["seed"].nunique(),
        lines=table(comparison.reset_index()),
    )


def _write_span(values: "pd.Series[float]") -> str:
    low, high = mean_interval(values.to_numpy(np.float64))
    return f"{values.mean():.3f} [{low:.3f}, {high:.3f}]"


if __name__ == "__main__":
    studies = Path(sys.argv[1])
    rows = [frame(studies / "placement" / name / "rows.jsonl") for name in ("fixture", "by_hand")]
    (studies / "placement.md").write_text(page(*rows), encoding="utf-8")
