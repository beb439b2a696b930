"""AUROC and average precision of scores, by scikit-learn; undefined cases are None, not a crash."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["auroc", "average_precision"]


def auroc(scores: NDArray[np.floating[Any]], is_defective: NDArray[np.bool_]) -> float | None:
    """Area under the ROC curve, ties at half; None when one of the two classes is absent."""
    from sklearn.metrics import roc_auc_score

    if is_defective.all() or not is_defective.any():
        return None
    return float(roc_auc_score(is_defective, scores))


def average_precision(scores: NDArray[np.floating[Any]], is_defective: NDArray[np.bool_]) -> float | None:
    """AUPRC as average precision: the step-wise sum, not the trapezoid, which flatters coarse scores.

    None when nothing is defective or nothing is sound. Its base rate is the defective share: never compare between
    fields of view.
    """
    from sklearn.metrics import average_precision_score

    if is_defective.all() or not is_defective.any():
        return None
    return float(average_precision_score(is_defective, scores))
