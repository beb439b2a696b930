"""Measures at the fitted limit: what the verdict reports, and what the map knew of it.

A gateway reports a press whose score lies above the limit. The map's peak may lie on the damage of a press that
passes; the two shares side by side say whether the features or the limit hide damage.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.trial import Trial
from calibration.fitting.folds import held_out_folds
from calibration.fitting.held_out import Learner, held_out_scores
from calibration.fitting.threshold import conformal_threshold
from edge.core.detector import Nominal
from edge.core.verdict import Kind, decide

__all__ = ["PEAK_PX", "fitted_limit", "is_on_damage", "limit_columns"]

PEAK_PX = 6
"""How far from the damage a map's peak may lie: one and a half cells of the finest tap."""

# As `gelgate fit` does without options.
_FOLDS, _SEED = 5, 0

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


def fitted_limit(learner: Learner, nominal: Nominal, trial: Trial) -> float:
    """The limit that a fit of these presses would set, from out-of-fold scores; their features are not taken again.

    Errors: FitError; ValueError for a trial without a false-alarm rate.
    """
    if trial.alpha is None:
        raise ValueError(f"the trial '{trial.name}' states no false-alarm rate")
    specimens = trial.nominal.specimens or (None,) * len(trial.nominal)
    folds, _ = held_out_folds(specimens, _FOLDS, np.random.default_rng(_SEED))
    scores = held_out_scores(learner, nominal, folds)
    return conformal_threshold(scores, trial.alpha, specimens=specimens).value


def is_on_damage(maps: NDArray[np.float32], masks: Mask) -> Mask:
    """Whether the largest value of each map lies on its mask or near it, bool (n,); False for an empty mask."""
    return np.array([_is_near(one, mask) for one, mask in zip(maps, masks, strict=True)], np.bool_)


def _is_near(one: NDArray[np.float32], mask: Mask) -> bool:
    row, column = np.unravel_index(int(one.argmax()), one.shape)
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool(away[row, column] <= PEAK_PX)


def limit_columns(
    limit: float, trial: Trial, maps: NDArray[np.float32], scores: Float, weights: Float
) -> dict[str, Float]:
    """Shares of the trial's frames at a limit, each (weightings,).

    weights: float64 (weightings, own presses). `detected` and `peak_found` are shares of the edits, `false_alarms` of
    the held-out presses, `relit_alarms` of those under another light; `others_detected` and `others_auroc`, presses of
    another object against the held-out ones, are added where there are some. Without weights of their own, the last
    three have no interval.
    """
    is_fail: Mask = np.array([decide(float(score), limit).kind is Kind.FAIL for score in scores], np.bool_)
    own = trial.is_own
    damaged: Mask = np.asarray(trial.masks[own].any(axis=(1, 2)), np.bool_)
    columns = {
        "detected": _share(is_fail[own], damaged, weights),
        "peak_found": _share(is_on_damage(maps[own], trial.masks[own]), damaged, weights),
        "false_alarms": _share(is_fail[own], ~damaged, weights),
    }
    if trial.is_relit is not None and trial.is_relit.any():
        columns["relit_alarms"] = _alone(is_fail[trial.is_relit].mean(), len(weights))
    if trial.is_other is not None and trial.is_other.any():
        others, sound = scores[trial.is_other], scores[own][~damaged]
        right = (others[:, None] > sound) + 0.5 * (others[:, None] == sound)
        columns["others_detected"] = _alone(is_fail[trial.is_other].mean(), len(weights))
        columns["others_auroc"] = _alone(right.mean(), len(weights))
    return columns


def _share(flags: Mask, chosen: Mask, weights: Float) -> Float:
    """The weighted share of the chosen presses that are flagged, (weightings,)."""
    of = weights[:, chosen]
    return np.asarray((of @ flags[chosen]) / of.sum(axis=1), np.float64)


def _alone(value: float, weightings: int) -> Float:
    return np.concatenate([[value], np.full(weightings - 1, np.nan)])
