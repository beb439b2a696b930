"""The measures of one detector on one set of presses, each with its two bootstrap intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.aupimo import AUPIMO_BOUNDS, aupimo_means
from calibration.metrics.aupro import AUPRO_LIMIT
from calibration.metrics.bootstrap import image_weights, interval, specimen_weights
from calibration.metrics.pixel import pixel_measures
from calibration.metrics.ranking import auroc
from calibration.metrics.regions import Maps, Masks

__all__ = ["REPLICATES", "Measure", "image_auroc_of", "limit_name", "measure"]

REPLICATES = 1000

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Measure:
    """One number and how sure it is.

    value: None when undefined, and then `reason` says why. The intervals are 95 % percentile bootstrap intervals over
    images and over specimens; None where they were not requested, or where specimens are not known.
    """

    name: str
    value: float | None
    over_images: tuple[float, float] | None = None
    over_specimens: tuple[float, float] | None = None
    reason: str | None = None


def limit_name(limit: float) -> str:
    """`aupro_fpr01` for a limit of 0.01: the name of the measure contains its limit."""
    digits = f"{limit:.6f}".rstrip("0").split(".")[1] if limit < 1 else "1"
    return f"aupro_fpr{digits}" if digits else "aupro_fpr1"


def measure(
    maps: Maps,
    masks: Masks,
    anomaly_scores: NDArray[np.floating[Any]],
    specimens: Sequence[str] | None = None,
    *,
    is_defective: NDArray[np.bool_] | None = None,
    limit: float = AUPRO_LIMIT,
    replicates: int = REPLICATES,
    seed: int = 0,
) -> tuple[Measure, ...]:
    """Image AUROC, pixel AUROC, AUPRC, AU-PRO to `limit` and AUPIMO of scored presses.

    maps, masks: one (h, w) per press, as in `calibration.metrics.regions`. anomaly_scores: (presses,). specimens: the
    id of each press's part; None leaves that interval out. is_defective: from the masks unless given
    (a defect that left no imprint has an empty mask but a bad part). replicates 0 leaves both intervals out.
    Errors: ValueError for shapes that do not pair or non-finite scores.
    """
    label = np.array([bool(m.any()) for m in masks], np.bool_) if is_defective is None else is_defective
    if anomaly_scores.shape != (len(maps),) or label.shape != (len(maps),):
        raise ValueError(f"each of the {len(maps)} maps needs one score and one label")
    if not np.isfinite(anomaly_scores).all():
        raise ValueError("an anomaly score is NaN or infinite, which has no rank")
    rng = np.random.default_rng(seed)
    images = image_weights(label, replicates, rng)
    parts = specimen_weights(specimens, label, replicates, rng) if specimens is not None else images[:0]
    weights = np.concatenate([np.ones((1, len(maps))), images, parts])
    pixel = pixel_measures(maps, masks, weights, limit)
    low, high = (f"{b:.0e}".replace("e-0", "e-") for b in AUPIMO_BOUNDS)
    columns = {
        "image_auroc": image_auroc_of(anomaly_scores, label, weights),
        "pixel_auroc": pixel.auroc,
        "pixel_auprc": pixel.average_precision,
        limit_name(limit): pixel.aupro,
        f"aupimo_{low}_{high}": aupimo_means(maps, masks, weights),
    }
    reason = _why_undefined(label, masks)
    return tuple(_measure(name, column, images.shape[0], reason) for name, column in columns.items())


def image_auroc_of(scores: NDArray[np.floating[Any]], label: NDArray[np.bool_], weights: Float) -> Float:
    """Compute it for each row of weights (weightings, presses), float64 (weightings,); NaN where undefined.

    The first row is ones.
    """
    values = np.full(weights.shape[0], np.nan)
    first = auroc(scores, label)
    if first is None:
        return values
    bad, good = scores[label].astype(np.float64), scores[~label].astype(np.float64)
    wins = (bad[:, None] > good).astype(np.float64) + 0.5 * (bad[:, None] == good)
    w_bad, w_good = weights[:, label], weights[:, ~label]
    pairs = w_bad.sum(axis=1) * w_good.sum(axis=1)
    is_defined = pairs > 0
    values[is_defined] = (
        np.einsum("rb,bg,rg->r", w_bad, wins, w_good, optimize=True)[is_defined] / pairs[is_defined]
    )
    values[0] = first
    return values


def _why_undefined(label: NDArray[np.bool_], masks: Masks) -> str:
    if not label.size:
        return "there is no press"
    if label.all():
        return "there is no good press"
    if not label.any():
        return "there is no defective press"
    if not any(m.any() for m in masks):
        return "every mask is empty"
    return "there is no sound pixel, or no press whose mask is empty"


def _measure(name: str, column: Float, replicates: int, reason: str) -> Measure:
    if not np.isfinite(column[0]):
        return Measure(name, None, reason=reason)
    images, parts = column[1 : 1 + replicates], column[1 + replicates :]
    return Measure(name, float(column[0]), interval(images), interval(parts) if parts.size else None)
