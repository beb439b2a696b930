"""Score maps as pictures: over the press for people, and as 16-bit numbers for programs.

Both are scaled by the threshold and not by the map's own maximum, so that the same colour means the same thing on every
press of a part, and a good press looks calm.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["SIXTEEN_BIT_THRESHOLD", "overlay", "overlay_png", "relative_scores", "score_map_png"]

# Colour starts at half the threshold and is saturated at twice: nominal presses stay below 1 by construction, and what
# is far above fails whatever its shade.
_FIRST_COLOUR: Final = 0.5
_LAST_COLOUR: Final = 2.0
_OPACITY: Final = 0.65

# The 16-bit value of a score that equals the threshold; a quarter of the range, so scores up to 4x can be told apart.
SIXTEEN_BIT_THRESHOLD: Final = 16384

# zlib level: 1 takes a third of the time of the default on such pictures, for a tenth more bytes.
_PNG: Final = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def relative_scores(score_map: NDArray[np.floating], threshold: float) -> NDArray[np.float32]:
    """Scores in units of the threshold, float32 (h, w). Errors: ValueError for what has no such scale."""
    if score_map.ndim != 2:
        raise ValueError(f"a score map is (h, w), found {score_map.shape}")
    if not (np.isfinite(threshold) and threshold > 0):
        raise ValueError(f"a threshold to scale by is finite and positive, found {threshold}")
    if not np.isfinite(score_map).all():
        raise ValueError(
            f"a score map is finite, found {int((~np.isfinite(score_map)).sum())} values that are not"
        )
    return (score_map.astype(np.float64) / threshold).astype(np.float32)


def overlay(rgb: NDArray[np.uint8], score_map: NDArray[np.floating], threshold: float) -> NDArray[np.uint8]:
    """The press with its scores in colour, uint8 (h, w, 3) RGB; white lines run where the score is the threshold.

    rgb: uint8 (h, w, 3), the inspected region. score_map: raw, (h, w) of the same region. Below half the threshold the
    press is shown as it is.
    """
    if rgb.dtype != np.uint8 or rgb.shape != (*score_map.shape, 3):
        raise ValueError(f"the picture must be uint8 {(*score_map.shape, 3)}, found {rgb.dtype} {rgb.shape}")
    relative = relative_scores(score_map, threshold)
    shade = np.clip((relative - _FIRST_COLOUR) / (_LAST_COLOUR - _FIRST_COLOUR), 0.0, 1.0)
    colours = cv2.applyColorMap(np.rint(shade * 255.0).astype(np.uint8), cv2.COLORMAP_TURBO)[:, :, ::-1]
    # Fades in up to the threshold, so that no edge appears where nothing happens.
    opacity = _OPACITY * np.clip((relative - _FIRST_COLOUR) / (1.0 - _FIRST_COLOUR), 0.0, 1.0)[:, :, None]
    mixed = rgb.astype(np.float32) * (1.0 - opacity) + colours.astype(np.float32) * opacity
    picture: NDArray[np.uint8] = np.rint(mixed).astype(np.uint8)
    lines, _ = cv2.findContours((relative > 1.0).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, lines, -1, (255, 255, 255), 1)
    return picture


def overlay_png(rgb: NDArray[np.uint8], score_map: NDArray[np.floating], threshold: float) -> bytes:
    """`overlay` as a PNG."""
    return _png(overlay(rgb, score_map, threshold)[:, :, ::-1])


def score_map_png(score_map: NDArray[np.floating], threshold: float) -> bytes:
    """The map itself as a 16-bit grey PNG: value = score / threshold * SIXTEEN_BIT_THRESHOLD, held in 0..65535."""
    scaled = relative_scores(score_map, threshold) * np.float32(SIXTEEN_BIT_THRESHOLD)
    return _png(np.rint(np.clip(scaled, 0, 65535)).astype(np.uint16))


def _png(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(picture), list(_PNG))
    if not encoded:
        raise ValueError(f"a picture of shape {picture.shape} cannot be encoded as PNG")
    return data.tobytes()
