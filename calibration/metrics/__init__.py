"""Exact measures of scored presses: AUROC, average precision, AU-PRO, AUPIMO, with bootstrap intervals.

A score is raw and higher is more anomalous. A measure that is undefined (no defective press, no good press) is None
with a reason.
"""

from calibration.metrics.aupimo import AUPIMO_BOUNDS, aupimo_means
from calibration.metrics.pixel import AUPRO_LIMIT, PixelMeasures, aupro, pixel_measures
from calibration.metrics.summary import (
    REPLICATES,
    Measure,
    auroc,
    image_weights,
    interval,
    limit_name,
    measure,
    specimen_weights,
)

__all__ = [
    "AUPIMO_BOUNDS",
    "AUPRO_LIMIT",
    "REPLICATES",
    "Measure",
    "PixelMeasures",
    "aupimo_means",
    "aupro",
    "auroc",
    "image_weights",
    "interval",
    "limit_name",
    "measure",
    "pixel_measures",
    "specimen_weights",
]
