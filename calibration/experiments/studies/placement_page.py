"""What the place of the part costs each method: the same part and damage, in a fixture and placed by hand.

`python -m calibration.experiments.studies.placement_page docs/studies` prints the page of docs/studies/placement: two
folders of rows of the good-fraction study, `fixture` and `by_hand`.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.experiments.harness.evidence import mean_interval
from calibration.experiments.harness.page import render
from calibration.experiments.harness.rows import frame

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page", "write"]


def page(fixture: "pd.DataFrame", by_hand: "pd.DataFrame") -> str:
    """Make the page, from the rows of both."""
    keys = ["backbone", "method"]
    held, placed = (rows.groupby(keys)["aupro_001"] for rows in (fixture, by_hand))
    found = held.agg(_write_span).to_frame("fixture")
    found["by hand"] = placed.agg(_write_span)
    found["difference"] = (placed.mean() - held.mean()).map("{:+.3f}".format)
    return render("placement", rows=by_hand, lines=found.reset_index())


def _write_span(values: "pd.Series[float]") -> str:
    low, high = mean_interval(values.to_numpy(np.float64))
    return f"{values.mean():.3f} [{low:.3f}, {high:.3f}]"


def write(folder: Path) -> Path:
    """Write placement.md into the folder, from its rows. Errors: ConfigError for rows that cannot be read."""
    rows = [frame(folder / "placement" / name / "rows.jsonl") for name in ("fixture", "by_hand")]
    target = folder / "placement.md"
    target.write_text(page(*rows), encoding="utf-8")
    return target


if __name__ == "__main__":
    print(write(Path(sys.argv[1])))
