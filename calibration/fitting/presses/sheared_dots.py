"""The dots of a marker gel where no picture shows it free: found in presses, each of which has sheared them."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.marker_dots import MarkerDots, find_marker_dots

__all__ = ["dot_light", "find_common_dots"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# Presses that must show dots, and how alike these are.
_WITNESSES, _ALIKE = 5, 0.2
# Levels between the brightest and the darkest colour, in the median: under white light relief is grey, as dots are.
_LEAST_COLOUR = 10.0
# The shift between dots is known as finely as this many pixels.
_COARSE_PX = 8


def find_common_dots(pictures: Sequence[U8], pixels_per_mm: float) -> MarkerDots | None:
    """Find the dots that several presses show, uint8 (h, w, 3) each, at their places in most; None for no such dots.

    A part with a regular dark texture may do so too, but on coloured lights relief turns colours and does not darken
    all of them.
    """
    rows = np.linspace(0, len(pictures) - 1, min(len(pictures), _WITNESSES)).round().astype(int)
    some = [pictures[k] for k in rows]
    if float(np.median([np.ptp(rgb, axis=2) for rgb in some])) < _LEAST_COLOUR:
        return None
    found = [dots for rgb in some if (dots := find_marker_dots(rgb, pixels_per_mm)) is not None]
    sizes = np.array([(dots.apart_px, dots.width_px) for dots in found])
    if len(found) < len(some) or np.any(np.ptp(sizes, axis=0) > _ALIKE * sizes.mean(axis=0)):
        return None
    first = max(found, key=lambda dots: len(dots.places))
    shifts = np.stack([first.find_shifts(rgb) for rgb in pictures])
    is_seen = ~np.isnan(shifts).all(axis=(0, 2))
    places = first.places.copy()
    places[is_seen] += np.nanmedian(shifts[:, is_seen], axis=0)
    return replace(first, places=np.round(places, 2))


def dot_light(dots: MarkerDots, pictures: Sequence[U8]) -> F32:
    """Compute what share of the light the dots leave, at their places in most presses, float32 (h, w, 3).

    Each press is moved back by the shift of its dots.
    """
    return np.asarray(np.median([_move_back(dots, rgb) for rgb in pictures], axis=0), np.float32)


def _move_back(dots: MarkerDots, rgb: U8) -> F32:
    """Return the share of the light in a press, its dots moved to their places, float32 (h, w, 3)."""
    height, width = rgb.shape[:2]
    share = np.asarray(rgb, np.float32) / np.maximum(dots.fill(rgb), 1)
    shifts = dots.find_shifts(rgb)
    is_seen = ~np.isnan(shifts[:, 0])
    y, x = np.mgrid[0:height:_COARSE_PX, 0:width:_COARSE_PX] + (_COARSE_PX - 1) / 2
    away = np.stack([x, y], axis=-1)[:, :, None] - dots.places[is_seen]
    weight = np.exp(-np.square(away / dots.apart_px).sum(axis=-1)) + 1e-9
    coarse = (weight @ shifts[is_seen]) / weight.sum(axis=-1, keepdims=True)
    shift = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    at_y, at_x = np.mgrid[:height, :width].astype(np.float32)
    moved = cv2.remap(
        share, at_x + shift[..., 0], at_y + shift[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, np.float32)
