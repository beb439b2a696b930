"""Score maps in colour: one scale and one colour map for every picture.

The scale is score / threshold and not the maximum of the map, so that a colour has the same meaning on every press of a
part. The colour map is OpenCV's INFERNO. Its lightness rises evenly with the score, so it is readable in a grey print
and for colour-blind people. A good press is dark, and a score just below the threshold (0.7 to 1 of it) is purple to
red. TURBO becomes darker again at its upper end, where the defects are, and VIRIDIS has no dark lower end.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, U8

__all__ = ["FULL_SCALE", "draw_contour", "paint_scores", "relative_scores", "score_at"]

FULL_SCALE: Final = 2.0
"""Score / threshold at the upper end of the colours, also for higher scores. The threshold is in the middle."""

_COLOURS: Final = cv2.COLORMAP_INFERNO
# Of each colour.
_CONTOUR: Final = 255
_CONTOUR_EDGE: Final = 0


def relative_scores(score_map: NDArray[np.floating], threshold: float) -> F32:
    """Scores in units of the threshold, float32 (h, w), 1 at the threshold; `score_at` is its inverse.

    Errors: ValueError for a wrong map or threshold.
    """
    if score_map.ndim != 2:
        raise ValueError(f"a score map is (h, w), found {score_map.shape}")
    if not np.isfinite(threshold):
        raise ValueError(f"a threshold to scale by is finite, found {threshold}")
    if not np.isfinite(score_map).all():
        raise ValueError(
            f"a score map is finite, found {int((~np.isfinite(score_map)).sum())} values that are not"
        )
    scores = score_map.astype(np.float64)
    relative = scores / threshold if threshold > 0 else 1 + (scores - threshold) / _unit(threshold)
    return relative.astype(np.float32)


def _unit(threshold: float) -> float:
    """The difference of scores that is drawn as 1: the threshold, or its distance from 0 where it is below, as those of
    likelihoods and logits are."""
    return abs(threshold) or 1.0


def score_at(relative: float, threshold: float) -> float:
    """The score that `relative_scores` gives this value."""
    return threshold + (relative - 1) * _unit(threshold)


def paint_scores(relative: F32) -> U8:
    """Colour relative scores (h, w) as uint8 (h, w, 3) RGB, from black (0) to pale yellow (FULL_SCALE and above)."""
    levels = np.rint(np.clip(relative / np.float32(FULL_SCALE), 0.0, 1.0) * np.float32(255.0))
    bgr = cv2.applyColorMap(levels.astype(np.uint8), _COLOURS)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def draw_contour(rgb: U8, relative: F32) -> None:
    """Draw a white line with a dark edge around the areas above the threshold; their inside is unchanged."""
    above = (relative > 1.0).astype(np.uint8)
    near, wide = (cv2.dilate(above, np.ones((side, side), np.uint8)) for side in (3, 5))
    for mask, level in ((wide - near, _CONTOUR_EDGE), (near - above, _CONTOUR)):
        cv2.copyTo(np.full_like(rgb, level), mask, rgb)  # in a tenth of the time of rgb[mask > 0] = level
