"""Whether a graph's scores rise with damage: nominal frames are scored with and without a painted square.

A graph of another author may give a likelihood, which falls with damage; a gateway that took it for an anomaly score
would pass every damaged part.
"""

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FitError
from edge.model.scorer import Scorer

__all__ = ["direction_warnings", "paint_square"]

MOST_FRAMES = 8
SATURATED_SHARE = 0.5
# Of the painted presses, that must score higher, or lower, for a direction to be known.
AGREEING_SHARE = 0.75


def direction_warnings(scorer: Scorer, frames: NDArray[np.uint8], scores: NDArray[np.float64]) -> list[str]:
    """Check the direction on some nominal frames, uint8 (n, h, w, 3) with their scores (n,).

    Errors: FitError where most painted frames score lower; a warning where most do not score higher, or where half of
    the nominal scores have one value, as scores that are limited to 0..1 do.
    """
    chosen = np.linspace(0, len(frames) - 1, min(MOST_FRAMES, len(frames))).astype(int)
    change = np.array([scorer.score(paint_square(frames[k])).anomaly_score - scores[k] for k in chosen])
    room = scorer.bundle.manifest.tolerance.around(float(np.abs(scores).max()))
    rising, falling, count = int((change > room).sum()), int((change < -room).sum()), len(change)
    if falling >= AGREEING_SHARE * count:
        raise FitError(
            f"scores fall where a press is damaged: a painted square lowers {falling} of {count} "
            f"nominal scores, their median change is {float(np.median(change)):.3g}; pass --negate if lower scores are "
            "more anomalous in this graph, or choose another output with --score-output"
        )
    said = []
    if rising < AGREEING_SHARE * count:
        said.append(
            f"a painted square raises {rising} and lowers {falling} of {count} nominal scores: whether higher scores "
            "are more anomalous is not known; score a damaged press before use"
        )
    largest = max(float((scores == value).mean()) for value in (scores.min(), scores.max()))
    if len(scores) >= 4 and largest > SATURATED_SHARE:
        said.append(
            f"{largest:.0%} of the nominal presses have one score: the graph limits its scores, so the threshold tells "
            "little; export it without its normalisation"
        )
    return said


def paint_square(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Copy a frame, uint8 (h, w, 3), with a square of a quarter of its side in the middle: half dark, half bright."""
    h, w = rgb.shape[:2]
    frame, half = rgb.copy(), max(1, min(h, w) // 8)
    frame[h // 2 - half : h // 2, w // 2 - half : w // 2 + half] = 20
    frame[h // 2 : h // 2 + half, w // 2 - half : w // 2 + half] = 235
    return frame
