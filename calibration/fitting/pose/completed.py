"""Completes nominal presses that lie in one pose: what one does not show, others do."""

from collections.abc import Sequence

import cv2
import numpy as np

from edge.core.arrays import F32, U8, Mask
from edge.core.registration.pose import Registered
from edge.core.registration.registrar import depth_of, fade

__all__ = ["complete_places", "completed"]

_SEED = 0


def completed(registered: Sequence[Registered]) -> U8:
    """Return the presses in the bank's pose, as `complete_places`."""
    return complete_places([placed.rgb for placed in registered], [placed.seen for placed in registered])


def complete_places(pictures: Sequence[U8], seen: Sequence[Mask]) -> U8:
    """Return the presses, uint8 (n, h, w, 3), each with its unseen places from the others in a random order.

    Neighbours are often presses of one piece, which differ less than presses do.
    """
    frames, rng = [], np.random.default_rng(_SEED)
    for picture, shown in zip(pictures, seen, strict=True):
        rgb, is_seen = picture.astype(np.float32), shown.copy()
        for other in rng.permutation(len(pictures)):
            if is_seen.all():
                break
            _fill(rgb, is_seen, pictures[other], seen[other])
        frames.append(np.rint(rgb).astype(np.uint8))
    return np.stack(frames)


def _fill(rgb: F32, seen: Mask, other: U8, shown: Mask) -> None:
    """Show another press at its places that are not seen yet, fading in from their rim."""
    more = shown & ~seen
    x, y, width, height = cv2.boundingRect(more.view(np.uint8))
    if not width:
        return
    box = slice(y, y + height), slice(x, x + width)
    weight = fade(depth_of(more[box]), rgb.shape)
    change = other[box] - rgb[box]
    rgb[box] += cv2.multiply(change, cv2.cvtColor(weight, cv2.COLOR_GRAY2RGB))
    # A seam is filled again by the next press: the mean press there would vary less than presses do.
    seen[box] |= weight >= 1
