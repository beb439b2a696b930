"""Measures at the fitted limit: what the verdict reports, and what the map knew of it.

A gateway reports a press whose score lies above the limit. The map's peak may lie on the damage of a press that
passes; the two shares side by side say whether the features or the limit hide damage.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.trial import PROFILE, Trial
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.folds import held_out_folds
from calibration.fitting.held_out import Learner
from calibration.fitting.limit_choice import Choice
from calibration.fitting.limit_step import LimitStep
from calibration.fitting.threshold import conformal_threshold
from edge.core.detector import Bank, Features, Nominal
from edge.core.imaging.region import Region
from edge.core.verdict import Kind, decide

__all__ = ["PEAK_PX", "FittedLimits", "fitted_limits", "is_on_damage", "limit_columns"]

PEAK_PX = 6
"""How far from the damage a map's peak may lie: one and a half cells of the finest tap."""

# As `gelgate fit` does without options.
_FOLDS, _SEED = FitConfig.folds, FitConfig.seed

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
U8 = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class FittedLimits:
    """plain: the limit of the raw scores. choice: what a fit would choose instead, if anything."""

    plain: float
    choice: Choice

    def applied(self, maps: NDArray[np.float32], scores: Float) -> tuple[NDArray[np.float32], Float, float]:
        """Raw maps (n, h, w) and scores (n,) as a bundle publishes them, and its limit."""
        if self.choice.chosen is None:
            return maps, scores, self.plain
        relative = [self.choice.chosen.limit.relative(one[None])[0] for one in maps]
        published = np.stack(relative).astype(np.float32)
        return published, np.asarray(published.max(axis=(1, 2)), np.float64), 1.0


def fitted_limits(
    learner: Learner, bank: Bank, nominal: Nominal, trial: Trial, take: Callable[[U8], Features]
) -> FittedLimits:
    """The limits that a fit of these presses would set; their features are not taken again.

    take: the features of frames. Errors: FitError; ValueError for a trial without a false-alarm rate.
    """
    if trial.alpha is None:
        raise ValueError(f"the trial '{trial.name}' states no false-alarm rate")
    specimens = trial.nominal.specimens or (None,) * len(trial.nominal)
    folds, _ = held_out_folds(specimens, _FOLDS, np.random.default_rng(_SEED))
    height, width = trial.frames.shape[1:3]
    region = Region((PROFILE.size[0] - width) // 2, (PROFILE.size[1] - height) // 2, width, height)
    step = LimitStep(learner, trial.nominal, (PROFILE, region), take, folds, trial.alpha)
    scores = step.scores(nominal, lambda fraction: None)
    plain = conformal_threshold(scores, trial.alpha, specimens=specimens).value
    return FittedLimits(plain, step.choice(bank, nominal))


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
    is_fail, own = _is_fail(scores, limit), trial.is_own
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


def _is_fail(scores: Float, limit: float) -> Mask:
    return np.array([decide(float(score), limit).kind is Kind.FAIL for score in scores], np.bool_)


def _share(flags: Mask, chosen: Mask, weights: Float) -> Float:
    """The weighted share of the chosen presses that are flagged, (weightings,)."""
    of = weights[:, chosen]
    return np.asarray((of @ flags[chosen]) / of.sum(axis=1), np.float64)


def _alone(value: float, weightings: int) -> Float:
    return np.concatenate([[value], np.full(weightings - 1, np.nan)])
