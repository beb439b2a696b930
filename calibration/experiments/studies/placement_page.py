"""What the place of the part costs each method: the same part and damage, in a fixture and placed by hand.

`python -m calibration.experiments.studies.placement_page docs/studies` prints the page of docs/studies/placement: two
folders of rows of the good-fraction study, `fixture` and `by_hand`.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.experiments.harness.intervals import mean_interval
from calibration.experiments.harness.page import table
from calibration.experiments.harness.rows import frame

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page", "write"]

_MEASURE = "aupro_001"


def page(fixture: "pd.DataFrame", by_hand: "pd.DataFrame") -> str:
    """The page, from the rows of both."""
    presses, seeds = int(by_hand["presses"].max()), by_hand["seed"].nunique()
    part = ", ".join(sorted(set(by_hand["part"])))
    return (
        "# What the place of the part costs\n\n"
        "A reference, printed from rows by `python -m calibration.experiments.studies.placement_page`.\n\n"
        f"{part}, {presses} nominal presses, {seeds} seeds, AU-PRO@0.01: mean [95 % interval over seeds]. Both columns "
        "have the same kinds of damage and every other effect; *by hand* is the scene as it is, *fixture* is without "
        f"`pose_jitter`.\n\n{_table(fixture, by_hand)}"
    )


def _table(fixture: "pd.DataFrame", by_hand: "pd.DataFrame") -> str:
    lines = []
    for (backbone, method), group in by_hand.groupby(["backbone", "method"]):
        same = fixture[(fixture["backbone"] == backbone) & (fixture["method"] == method)]
        held, placed = same[_MEASURE].to_numpy(np.float64), group[_MEASURE].to_numpy(np.float64)
        lost = f"{placed.mean() - held.mean():+.3f}"
        lines.append([backbone, method, _spanned(held), _spanned(placed), lost])
    return table(["backbone", "method", "fixture", "by hand", "difference"], lines)


def _spanned(values: np.ndarray) -> str:
    low, high = mean_interval(values)
    return f"{values.mean():.3f} [{low:.3f}, {high:.3f}]"


def write(folder: Path) -> Path:
    """Write placement.md into the folder, from its rows. Errors: ConfigError for rows that cannot be read."""
    rows = [frame(folder / "placement" / name / "rows.jsonl") for name in ("fixture", "by_hand")]
    target = folder / "placement.md"
    target.write_text(page(*rows), encoding="utf-8")
    return target


if __name__ == "__main__":
    print(write(Path(sys.argv[1])))
