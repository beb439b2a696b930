"""Whether presses are of two parts: in one pose they then differ in one way, each by one of two amounts."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.pose.registration import LearntPose
from calibration.fitting.presses.strangers import list_names
from edge.core.arrays import F32, F64, Mask

__all__ = ["find_two_parts"]

_BLUR_PX, _SIDE_PX = 2.0, 56
# Places where the part shows at least this share of its strongest relief.
_RELIEF_SHARE = 0.1
_FEWEST = 3
# The least gap between the two amounts, in standard deviations within them, and their distance as a share of the
# relief: up to 1.0 and 0.54 on 22 sets of one part, 4.6 and 1.0 and more on eight sets of two parts. Of 12,000 draws of
# 6 to 12 presses of one part none has both. Two balls have at most 1.8 and 0.5: they differ like presses of one ball.
_LEAST_GAP, _LEAST_SHARE = 2.5, 0.9


def find_two_parts(learnt: LearntPose, names: Sequence[str]) -> list[str]:
    """Name the presses of the rarer of two parts, by what presses differ most in where the part shows."""
    if len(names) < 2 * _FEWEST:
        return []
    relief = _shrink(learnt.part.template) - _shrink(learnt.part.free)
    strength = np.sqrt((relief**2).sum(axis=2))
    shows = strength > _RELIEF_SHARE * float(strength.max())
    views = np.stack([_shrink(placed.rgb) for placed in learnt.registered])
    seen = np.stack([_shrink(placed.seen) for placed in learnt.registered]) > 1 - 1e-3
    amounts = _find_amounts(views[:, shows], seen[:, shows])
    order = np.argsort(amounts, kind="stable")
    first, gap, distance = _divide(amounts[order])
    share = distance / max(float(np.sqrt((relief[shows] ** 2).sum(axis=1).mean())), 1.0)
    if gap < _LEAST_GAP or share < _LEAST_SHARE:
        return []
    rarer = np.sort(order[:first] if 2 * first < len(order) else order[first:])
    named = [names[k] for k in rarer.tolist()]
    return [
        f"the presses look like two parts: {list_names(named, len(names))} differ from the others by {share:.1f} times "
        f"the relief; look at them, and fit each part alone (--leave-out '{named[0]}')"
    ]


def _shrink(picture: NDArray[np.generic]) -> F32:
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _BLUR_PX)
    height, width = blurred.shape[:2]
    factor = min(1.0, _SIDE_PX / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    return np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float32)


def _find_amounts(views: F32, seen: Mask) -> F64:
    """Find how much of what presses differ in most each of them shows, levels (n,).

    views: (n, places, 3), by places that each press shows, bool (n, places). The first principal component, by the
    mean product over the places that both of two presses show.
    """
    weights = seen.astype(np.float64)
    mean = (views * seen[..., None]).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
    away = ((views - mean) * seen[..., None]).reshape(len(views), -1).astype(np.float64)
    products = away @ away.T / np.maximum(weights @ weights.T, 1)
    centre = np.eye(len(views)) - 1 / len(views)
    values, vectors = np.linalg.eigh(centre @ products @ centre)
    return np.asarray(vectors[:, -1] * np.sqrt(max(float(values[-1]), 0.0)))


def _divide(ordered: F64) -> tuple[int, float, float]:
    """Divide rising amounts in two, so that they vary least within: the first ones, the gap, the means' distance.

    The gap between them is in standard deviations within them.
    """

    def varies(first: int) -> float:
        return sum(float(((part - part.mean()) ** 2).sum()) for part in np.split(ordered, [first]))

    first = min(range(_FEWEST, len(ordered) - _FEWEST + 1), key=varies)
    low, high = np.split(ordered, [first])
    within = max(float(np.sqrt(varies(first) / (len(ordered) - 2))), float(np.finfo(np.float32).tiny))
    return first, float(high[0] - low[-1]) / within, float(high.mean() - low.mean())
