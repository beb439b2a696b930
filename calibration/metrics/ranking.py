"""AUROC and average precision of scores; undefined cases are None."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["auroc", "average_precision"]


def auroc(scores: NDArray[np.floating[Any]], is_defective: NDArray[np.bool_]) -> float | None:
    """Area under the ROC curve, ties at half; None when one of the two classes is absent.

    The share of pairs, one defective and one sound, in which the defective one scores higher. Errors: ValueError.
    """
    _check(scores, is_defective)
    sound, defective = np.sort(scores[~is_defective]), scores[is_defective]
    if not (sound.size and defective.size):
        return None
    lower = np.searchsorted(sound, defective, "left") + np.searchsorted(sound, defective, "right")
    return float(lower.mean() / (2 * sound.size))


def average_precision(scores: NDArray[np.floating[Any]], is_defective: NDArray[np.bool_]) -> float | None:
    """AUPRC as average precision: the step-wise sum, not the trapezoid, which overestimates coarse scores.

    None when nothing is defective or nothing is sound. Its base rate is the defective share, so values from different
    fields of view cannot be compared. Errors: ValueError.
    """
    _check(scores, is_defective)
    if is_defective.all() or not is_defective.any():
        return None
    order = np.argsort(scores)[::-1]
    falling = scores[order]
    last_of_tie = np.flatnonzero(np.append(falling[1:] != falling[:-1], True))
    found = np.cumsum(is_defective[order])[last_of_tie]
    return float(np.sum(np.diff(found, prepend=0) * found / (last_of_tie + 1)) / found[-1])


def _check(scores: NDArray[np.floating[Any]], is_defective: NDArray[np.bool_]) -> None:
    if scores.shape != is_defective.shape:
        raise ValueError(
            f"each score has one label: found {scores.shape} scores and {is_defective.shape} labels"
        )
    if not np.isfinite(scores).all():
        raise ValueError("a score is NaN or infinite and has no rank; leave that image out")
