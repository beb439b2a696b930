"""Completes nominal presses in the bank's pose: what one does not show, others do."""

from collections.abc import Sequence

import cv2
import numpy as np

from edge.core.arrays import F32, U8, Mask
from edge.core.registration.pose import Registered
from edge.core.registration.registrar import depth_of, fade

__all__ = ["completed"]

_SEED = 0


def completed(registered: Sequence[Registered]) -> U8:
    """The presses, uint8 (n, h, w, 3), each with its unseen places from the others in a random order.

    Neighbours are often presses of one piece, which differ less than presses do.
    """
    frames, rng = [], np.random.default_rng(_SEED)
    for one in registered:
        rgb, seen = one.rgb.astype(np.float32), one.seen.copy()
        for other in (registered[k] for k in rng.permutation(len(registered))):
            if seen.all():
                break
            _fill(rgb, seen, other)
        frames.append(np.rint(rgb).astype(np.uint8))
    return np.stack(frames)


def _fill(rgb: F32, seen: Mask, other: Registered) -> None:
    """Show another press at its places that are not seen yet, fading in from their rim."""
    more = other.seen & ~seen
    x, y, width, height = cv2.boundingRect(more.view(np.uint8))
    if not width:
        return
    box = slice(y, y + height), slice(x, x + width)
    weight = fade(depth_of(more[box]), rgb.shape)
    change = other.rgb[box] - rgb[box]
    rgb[box] += cv2.multiply(change, cv2.cvtColor(weight, cv2.COLOR_GRAY2RGB))
    # A seam is filled again by the next press: the mean press there would vary less than presses do.
    seen[box] |= weight >= 1
