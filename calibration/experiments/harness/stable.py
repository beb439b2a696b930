"""The stable fraction of a method: the share of the nominal presses at which validations 2 and 3 fix it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from calibration.experiments.harness.effects import COMPARED
from calibration.experiments.harness.published import stable_fraction
from calibration.experiments.harness.rows import read_rows
from edge.core.detector import Mode
from edge.core.errors import ConfigError

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
    wanted = {"study": "good-fraction", "method": method, "mode": mode, "backbone": backbone}
    rows = [row for row in read_rows(file) if all(row[k] == v for k, v in wanted.items())]
    found = stable_from([row for row in rows if row["split"] == split]) or stable_from(rows)
    if found is None:
        raise ConfigError(
            f"the stable fraction of {method} ({mode}, {backbone}) is not known: '{file}' has no rows of "
            "good-fraction with it; run `gelgate lab study good-fraction` into the same folder, or give --fraction"
        )
    return found


def stable_from(rows: Sequence[Mapping[str, Any]]) -> float | None:
    """The smallest fraction from which on every mean is near that of the largest fraction; None without rows.

    rows: of one method, mode, backbone and split. The rule holds for all parts and the three measures of the paper
    together, so that a method has one value, as in the paper.
    """
    values: dict[tuple[str, str, str], dict[float, list[float]]] = {}
    for row in rows:
        for measure in COMPARED:
            if row.get("fraction") is not None and row.get(measure) is not None:
                curve = values.setdefault((row["part"], row["position"], measure), {})
                curve.setdefault(row["fraction"], []).append(row[measure])
    return max(
        (_flat_from({f: fmean(v) for f, v in curve.items()}) for curve in values.values()), default=None
    )


def _flat_from(curve: Mapping[float, float]) -> float:
    """The first fraction of the flat end of one curve: all means there are near the last one."""
    last = curve[max(curve)]
    far = [fraction for fraction, mean in curve.items() if abs(mean - last) > STABLE_WITHIN]
    return min(fraction for fraction in curve if not far or fraction > max(far))
