"""The measures of one detector on one set of presses, each with its two bootstrap intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.aupimo import AUPIMO_BOUNDS, aupimo_means
from calibration.metrics.pixel import AUPRO_LIMIT, Maps, Masks, pixel_measures
from edge.core.arrays import F64, Mask

__all__ = [
    "REPLICATES",
    "Measure",
    "auroc",
    "image_auroc_of",
    "image_weights",
    "interval",
    "limit_name",
    "measure",
    "recall_at",
    "specimen_weights",
]

REPLICATES = 1000


@dataclass(frozen=True)
class Measure:
    """One number and how sure it is."""

    name: str
    value: float | None
    """None when undefined, and then `reason` says why. The intervals are 95 % percentile bootstrap intervals over
    images and over specimens; None where they were not requested, or where specimens are not known."""
    over_images: tuple[float, float] | None = None
    over_specimens: tuple[float, float] | None = None
    reason: str | None = None


def limit_name(limit: float) -> str:
    """Name AU-PRO by its limit: `aupro_fpr01` for 0.01, by the digits behind the point; `aupro_fpr1.0` for 1."""
    return f"aupro_fpr{f'{limit:.12f}'.rstrip('0').split('.')[1]}" if limit < 1 else "aupro_fpr1.0"


def measure(
    maps: Maps,
    masks: Masks,
    anomaly_scores: NDArray[np.floating[Any]],
    specimens: Sequence[str] | None = None,
    *,
    is_defective: Mask | None = None,
    limit: float = AUPRO_LIMIT,
    replicates: int = REPLICATES,
    seed: int = 0,
) -> tuple[Measure, ...]:
    """Image AUROC, pixel AUROC, AUPRC, AU-PRO to `limit` and AUPIMO of scored presses.

    maps, masks: one (h, w) per press, as in `calibration.metrics.pixel`. anomaly_scores: (presses,). specimens: the
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
        f"aupimo_{low}_{high}": aupimo_means(maps, masks, weights, is_defective=label),
    }
    reason = _why_undefined(label, masks)
    return tuple(_measure(name, column, images.shape[0], reason) for name, column in columns.items())


def image_auroc_of(scores: NDArray[np.floating[Any]], label: Mask, weights: F64) -> F64:
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


def _why_undefined(label: Mask, masks: Masks) -> str:
    if not label.size:
        return "there is no press"
    if label.all():
        return "there is no good press"
    if not label.any():
        return "there is no defective press"
    if not any(m.any() for m in masks):
        return "every mask is empty"
    return "there is no sound pixel, or no press whose mask is empty"


def _measure(name: str, column: F64, replicates: int, reason: str) -> Measure:
    if not np.isfinite(column[0]):
        return Measure(name, None, reason=reason)
    images, parts = column[1 : 1 + replicates], column[1 + replicates :]
    return Measure(name, float(column[0]), interval(images), interval(parts) if parts.size else None)


CONFIDENCE = 0.95


def image_weights(is_defective: Mask, replicates: int, rng: np.random.Generator) -> F64:
    """Multiplicities float64 (replicates, images), each image its own unit."""
    return specimen_weights([str(i) for i in range(is_defective.size)], is_defective, replicates, rng)


def specimen_weights(
    specimens: Sequence[str], is_defective: Mask, replicates: int, rng: np.random.Generator
) -> F64:
    """Multiplicities float64 (replicates, images), all images of a specimen together.

    A specimen with any defective image is drawn among the defective ones, its good images with it.
    """
    names, unit = np.unique(np.asarray(specimens), return_inverse=True)
    if unit.size != is_defective.size:
        raise ValueError(f"each image needs a specimen, found {unit.size} for {is_defective.size} images")
    unit_is_defective = np.zeros(names.size, np.bool_)
    np.logical_or.at(unit_is_defective, unit, is_defective)
    weights = np.zeros((replicates, names.size))
    for stratum in (np.flatnonzero(~unit_is_defective), np.flatnonzero(unit_is_defective)):
        if stratum.size:
            even = np.full(stratum.size, 1.0 / stratum.size)
            weights[:, stratum] = rng.multinomial(stratum.size, even, size=replicates)
    return weights[:, unit]


def interval(values: F64) -> tuple[float, float] | None:
    """The percentile interval of the replicates that are defined; None when fewer than half are."""
    defined = values[np.isfinite(values)]
    if defined.size * 2 < values.size or not defined.size:
        return None
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(defined, [tail, 100.0 - tail])
    return float(low), float(high)


def auroc(scores: NDArray[np.floating[Any]], is_defective: Mask) -> float | None:
    """Area under the ROC curve, ties at half; None when one of the two classes is absent.

    The share of pairs, one defective and one sound, in which the defective one scores higher. Errors: ValueError.
    """
    _check(scores, is_defective)
    sound, defective = np.sort(scores[~is_defective]), scores[is_defective]
    if not (sound.size and defective.size):
        return None
    lower = np.searchsorted(sound, defective, "left") + np.searchsorted(sound, defective, "right")
    return float(lower.mean() / (2 * sound.size))


def recall_at(
    scores: NDArray[np.floating[Any]],
    is_defective: Mask,
    weights: F64,
    rate: float,
) -> F64:
    """Return the share of defective presses above the lowest threshold with at most `rate` false alarms, per weighting.

    scores: (presses,). weights: (weightings, presses). A press alarms when its score is above the threshold, and a
    threshold is the score of a sound press; NaN where a weighting lacks a class.
    """
    sound, order = scores[~is_defective], np.argsort(scores[~is_defective])[::-1]
    falling = sound[order]
    counted = weights[:, ~is_defective][:, order]
    first_of_tie = np.searchsorted(-falling, -falling, side="left")
    above = np.concatenate([np.zeros((len(weights), 1)), np.cumsum(counted, axis=1)], axis=1)[:, first_of_tie]
    total_sound, bad = counted.sum(axis=1), weights[:, is_defective]
    allowed = above <= rate * total_sound[:, None] + 1e-9
    last = allowed.shape[1] - 1 - np.argmax(allowed[:, ::-1], axis=1)
    hits = ((scores[is_defective][None] > falling[last][:, None]) * bad).sum(axis=1)
    total_bad = bad.sum(axis=1)
    is_defined = (total_sound > 0) & (total_bad > 0)
    return np.where(is_defined, hits / np.where(is_defined, total_bad, 1.0), np.nan)


def _check(scores: NDArray[np.floating[Any]], is_defective: Mask) -> None:
    if scores.shape != is_defective.shape:
        raise ValueError(
            f"each score has one label: found {scores.shape} scores and {is_defective.shape} labels"
        )
    if not np.isfinite(scores).all():
        raise ValueError("a score is NaN or infinite and has no rank; leave that image out")
