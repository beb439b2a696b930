"""The stable fraction of a method: the share of the nominal presses at which validations 2 and 3 fix it."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.experiments.harness.evidence import COMPARED
from calibration.experiments.harness.published import stable_fraction
from calibration.experiments.harness.rows import frame
from edge.core.detector import Mode
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STABLE_WITHIN", "find_stable_fraction", "stable_from"]

STABLE_WITHIN = 0.01
"""How far the mean over seeds may be from that of all presses, for every larger fraction, part and measure."""


def find_stable_fraction(file: Path, method: str, mode: Mode, backbone: str, split: str) -> float:
    """Return the stable fraction of a method, in (0, 1].

    file: with rows of the good-fraction study; those of another split serve where this one has none. In `paper` mode a
    method of the paper has the paper's own value. Errors: ConfigError where it is not known.
    """
    if mode == "paper" and (own := stable_fraction(method)) is not None:
        return own
    rows = frame(file)
    for column, value in {
        "study": "good-fraction",
        "method": method,
        "mode": mode,
        "backbone": backbone,
    }.items():
        rows = rows[rows[column] == value] if column in rows else rows
    found = None if rows.empty else stable_from(rows[rows["split"] == split]) or stable_from(rows)
    if found is None:
        raise ConfigError(
            f"the stable fraction of {method} ({mode}, {backbone}) is not known: '{file}' has no rows of "
            "good-fraction with it; run `gelgate lab study good-fraction` into the same folder, or give --fraction"
        )
    return found


def stable_from(rows: "pd.DataFrame") -> float | None:
    """Return the smallest fraction from which on every mean is near that of the largest fraction; None without rows.

    rows: of one method, mode, backbone and split. The rule holds for all parts and the three measures of the paper
    together, so that a method has one value, as in the paper.
    """
    curves = rows.reindex(columns=["part", "position", "fraction", *COMPARED])
    long = curves.melt(["part", "position", "fraction"], var_name="measure").dropna()
    means = long.groupby(["part", "position", "measure", "fraction"])["value"].mean()
    flat = [_flat_from(curve.droplevel([0, 1, 2])) for _, curve in means.groupby(level=[0, 1, 2])]
    return max(flat, default=None)


def _flat_from(curve: "pd.Series[float]") -> float:
    """Return the first fraction of the flat end of one curve: all means there are near the last one."""
    far = curve.index[(curve - curve.iloc[-1]).abs() > STABLE_WITHIN]
    return float(min(curve.index if far.empty else curve.index[curve.index > far.max()]))
