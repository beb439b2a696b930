"""Curves of the good-fraction study: means over seeds with their intervals, at each number of nominal presses."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.studies.intervals import is_drawn, mean_interval
from edge.core.gel import DEFAULT_LIMIT_PRESSES

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MEASURE_NAMES", "Curve", "curves", "gel_share", "same_in_every_seed"]

MEASURE_NAMES = {
    "aupro_001": "AU-PRO@0.01",
    "aupro_005": "AU-PRO@0.05",
    "auprc": "AUPRC",
    "pixel_auroc": "pixel AUROC",
    "image_auroc": "image AUROC",
    "recall_001": "recall at 1 % false alarms",
}


@dataclass(frozen=True)
class Curve:
    """One method on one part. x: the fractions or shots, rising, (m,). values: each seed's, a row per x. mean, low,
    high: over seeds, with the 95 % interval of the mean, (m,), nan where too few presses were drawn for one. presses:
    nominal presses at each x, (m,)."""

    part: str
    method: str
    x: NDArray[np.float64]
    values: tuple[NDArray[np.float64], ...]
    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    presses: NDArray[np.int64]


def curves(rows: "pd.DataFrame", x: str, measure: str) -> Iterator[Curve]:
    """The curves of one backbone, mode and split. x: the column that varies, `fraction` or `shots`."""
    if x not in rows or measure not in rows:
        return
    for (part, method), group in rows.dropna(subset=[x, measure]).groupby(["part", "method"]):
        at = list(group.groupby(x))
        values = tuple(cell[measure].to_numpy(np.float64) for _, cell in at)
        spans = [_interval(cell, each) for (_, cell), each in zip(at, values, strict=True)]
        yield Curve(
            part,
            method,
            np.array([float(value) for value, _ in at]),
            values,
            np.array([each.mean() for each in values]),
            np.array([low for low, _ in spans]),
            np.array([high for _, high in spans]),
            np.array([int(cell["presses"].max()) for _, cell in at]),
        )


def _interval(cell: "pd.DataFrame", values: NDArray[np.float64]) -> tuple[float, float]:
    """Of the mean over the seeds of a cell; nan where they learn the same presses."""
    if not any(is_drawn(row) for row in cell.to_dict("records")):
        return math.nan, math.nan
    return mean_interval(values)


def gel_share(presses: float) -> float:
    """The part of a gel's rated life that this number of presses uses, 1 is all of it."""
    return presses / DEFAULT_LIMIT_PRESSES


def same_in_every_seed(rows: "pd.DataFrame") -> "pd.DataFrame":
    """Cells of several seeds whose scores are identical: one computation, whose lack of scatter says nothing.

    Columns part, method, fraction, shots (NaN where not varied) and seeds.
    """
    import pandas as pd

    sizes = [name for name in ("fraction", "shots") if name in rows]
    grouped = rows.groupby(["part", "method", *sizes], dropna=False)["scores_sha256"]
    found = pd.DataFrame({"seeds": grouped.size(), "results": grouped.nunique()}).reset_index()
    return found[(found["seeds"] > 1) & (found["results"] == 1)].drop(columns="results")
