"""How good one point is: four measures of its scored presses, with intervals bootstrapped by piece."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.pixel import pixel_measures
from calibration.metrics.summary import image_auroc_of, interval, recall_at
from edge.core.arrays import F32, F64, Mask

__all__ = ["MEASURES", "Truth", "measure_accuracy"]

FALSE_ALARMS: Final = 0.01
"""The false-positive rate of AU-PRO (pixels) and of the recall (presses)."""

MEASURES: Final = ("aupro_fpr01", "pixel_auprc", "image_auroc", "recall_fpr01")
"""AU-PRO, AUPRC of pixels, AUROC of presses, and recall of presses."""


@dataclass(frozen=True)
class Truth:
    """What is known of the scored presses."""

    label: Mask
    masks: Sequence[Mask]
    """bool (h, w) each."""
    weights: F64
    """float64 (replicates + 1, presses), the first row ones, then how often each press counts in a replicate drawn by
    piece."""


def measure_accuracy(
    maps: Sequence[F32], scores: NDArray[np.floating[Any]], truth: Truth
) -> dict[str, dict[str, float | None]]:
    """Each measure with its value and the 95 % interval, low and high; None where it is undefined."""
    pixel = pixel_measures(maps, truth.masks, truth.weights, FALSE_ALARMS)
    columns = {
        "aupro_fpr01": pixel.aupro,
        "pixel_auprc": pixel.average_precision,
        "image_auroc": image_auroc_of(scores, truth.label, truth.weights),
        "recall_fpr01": recall_at(scores, truth.label, truth.weights, FALSE_ALARMS),
    }
    accuracy = {}
    for name in MEASURES:
        value, *drawn = columns[name]
        low, high = interval(np.array(drawn)) or (None, None)
        accuracy[name] = {"value": float(value) if np.isfinite(value) else None, "low": low, "high": high}
    return accuracy
