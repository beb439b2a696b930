"""Small edits of real presses, for no damaged part is public: pieces of real relief, marker dots.

An edit stands for damage and is none: it shows what a detector sees of a small change, and not which damage occurs.
Every random choice comes from the generator that is given, so a seed gives the same edits everywhere.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, U8, Mask
from edge.core.errors import DatasetError

__all__ = [
    "MIN_PEAK_LEVELS",
    "Edited",
    "add_dot",
    "add_relief",
    "between_dots",
    "dots",
    "near_dots",
    "relief",
    "remove_dot",
    "without_dots",
]

SIDE_PX = (10, 20)
"""Smallest and largest side of a blended piece: 0.6 to 1.3 mm on a GelSight Mini."""
# The piece is cut larger and shrunk, so that it shows a smaller feature than the one that the donor has.
_SHRUNK = (0.5, 0.8)
# The share of the radius over which the piece fades out.
_FADING = 0.5
MIN_PEAK_LEVELS = 20.0
"""A piece that changes no pixel by this much is drawn again: it could not be seen."""
# Of this share of the largest change is an edit's damage; below it the piece has faded out.
_VISIBLE = 0.25
# Of each donor.
_DRAWS = 50
# Sum over the channels of the difference to the free gel where there is relief to cut from.
_RELIEF_LEVELS = 30.0

# A marker dot: darker than its surroundings of 17 pixels by this much, with an area in this range. An added dot keeps a
# distance from the next one.
_DOT_LEVELS, _SURROUNDINGS_PX = 25, 17
_DOT_AREA_PX = (12, 200)
_RIM_PX, _NEAR_PX = 2, 4
_APART_PX = 10


class Edited(NamedTuple):
    """An edited press."""

    rgb: U8
    """uint8 (h, w, 3)."""
    mask: Mask
    """Where it shows, bool (h, w), one connected region."""


def relief(rgb: U8, free: U8) -> F32:
    """The difference of a press to the free gel in grey levels, float32 (h, w, 3), without a change of the light."""
    difference = rgb.astype(np.float32) - free
    return np.asarray(difference - np.median(difference, axis=(0, 1)), np.float32)


def add_relief(rgb: U8, donors: Sequence[F32], spots: Mask, rng: np.random.Generator) -> Edited:
    """A press with a piece of another press's relief, shrunk, feathered, raised or sunk. donors: the `relief` of other
    presses. spots: where the piece's centre may lie, bool (h, w). Errors: DatasetError where no piece of any donor
    shows, or no spot is free."""
    places = _places(spots, "place for an edit")
    for index in rng.permutation(len(donors)):
        donor = donors[index]
        sources = np.argwhere(cv2.blur(np.abs(donor).sum(axis=2), (9, 9)) > _RELIEF_LEVELS)
        for _ in range(_DRAWS if len(sources) else 0):
            source, place = sources[rng.integers(len(sources))], places[rng.integers(len(places))]
            edited = _blended(rgb, donor, source, place, rng)
            if edited is not None:
                return edited
    raise DatasetError(
        f"no piece of {len(donors)} presses' relief changes a press by {MIN_PEAK_LEVELS:g} levels; leave it out"
    )


def _blended(
    rgb: U8, donor: F32, source: NDArray[np.int64], place: NDArray[np.int64], rng: np.random.Generator
) -> Edited | None:
    """The press with a piece around `source` at `place`; None where it does not fit or too little of it is seen."""
    side = int(rng.integers(SIDE_PX[0], SIDE_PX[1] + 1))
    cut = _cut(donor, source, round(side / rng.uniform(*_SHRUNK)))
    sign = float(rng.choice([-1.0, 1.0]))
    change = np.zeros(rgb.shape, np.float32)
    target = _cut(change, place, side)
    if cut is None or target is None:
        return None
    small = np.asarray(cv2.resize(cut, (side, side), interpolation=cv2.INTER_AREA), np.float32)
    # 1 in the middle, falling to 0 at the inscribed circle as half a cosine; the mean of each colour becomes 0.
    along = (np.arange(side) - (side - 1) / 2) / (side / 2)
    faded = np.clip((np.hypot(along[:, None], along) - (1 - _FADING)) / _FADING, 0, 1)
    weight = np.asarray(0.5 * (1 + np.cos(np.pi * faded)), np.float32)[..., None]
    target[:] = sign * ((small - (small * weight).sum(axis=(0, 1)) / weight.sum()) * weight)
    edited = np.clip(np.round(rgb + change), 0, 255).astype(np.uint8)
    seen = np.abs(edited.astype(np.float32) - rgb).max(axis=2)
    peak = float(seen.max())
    return None if peak < MIN_PEAK_LEVELS else Edited(edited, _hull(seen > _VISIBLE * peak))


def _cut(picture: F32, centre: NDArray[np.int64], side: int) -> F32 | None:
    """A square of a picture, (side, side, 3); None where it would leave the picture."""
    row, column = (centre - side // 2).tolist()
    if min(row, column) < 0 or row + side > picture.shape[0] or column + side > picture.shape[1]:
        return None
    return picture[row : row + side, column : column + side]


def _places(allowed: Mask, what: str) -> NDArray[np.int64]:
    """The (row, column) of every allowed pixel. Errors: DatasetError for none."""
    found = np.argwhere(allowed)
    if not len(found):
        raise DatasetError(f"the press has no {what}; leave it out")
    return found


def _hull(seen: Mask) -> Mask:
    """Return one region: a piece has bright and dark parts with unchanged pixels between them."""
    columns_rows = np.argwhere(seen)[:, ::-1].astype(np.int32)
    filled = np.zeros(seen.shape, np.uint8)
    cv2.fillConvexPoly(filled, cv2.convexHull(columns_rows), 1)
    return np.asarray(filled > 0)


def dots(rgb: U8) -> NDArray[np.int32]:
    """The marker dots of a tracking gel: 0 between them, else the dot's number from 1, int32 (h, w)."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
    dark = cv2.morphologyEx(grey, cv2.MORPH_BLACKHAT, around) > _DOT_LEVELS
    _, labels, facts, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    areas = facts[:, cv2.CC_STAT_AREA]
    is_dot = (areas >= _DOT_AREA_PX[0]) & (areas <= _DOT_AREA_PX[1])
    is_dot[0] = False
    numbers = np.where(is_dot, np.cumsum(is_dot), 0)
    return np.asarray(numbers[labels], np.int32)


def near_dots(rgb: U8) -> Mask:
    """On a marker dot or its rim, bool (h, w)."""
    return _grown(dots(rgb) > 0, _NEAR_PX)


def between_dots(relief: F32, rgb: U8, free: U8) -> F32:
    """A relief, filled from its surroundings where the press or the free gel has a marker dot; the dots move."""
    marked = (_grown(dots(rgb) > 0, _RIM_PX) | _grown(dots(free) > 0, _RIM_PX)).astype(np.uint8)
    planes = (np.ascontiguousarray(relief[..., k]) for k in range(3))
    return np.asarray(
        np.dstack([cv2.inpaint(one, marked, 3, cv2.INPAINT_TELEA) for one in planes]), np.float32
    )


def without_dots(rgb: U8, marked: Mask) -> U8:
    """The picture with the marked dots filled from their surroundings."""
    return np.asarray(cv2.inpaint(rgb, _grown(marked, _RIM_PX).astype(np.uint8), 3, cv2.INPAINT_TELEA))


def _grown(mask: Mask, px: int) -> Mask:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * px + 1, 2 * px + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)


def remove_dot(rgb: U8, spots: Mask, rng: np.random.Generator) -> Edited:
    """A press in which one marker dot with its centre in `spots` is missing. Errors: DatasetError for none there."""
    numbers = dots(rgb)
    # A dot that touches the border of the spots is left out: the mask would be cut.
    inside = np.setdiff1d(np.unique(numbers[spots]), np.append(np.unique(numbers[~spots]), 0))
    if not len(inside):
        raise DatasetError("the press has no marker dot where one is to be removed; leave it out")
    gone = numbers == rng.choice(inside)
    return Edited(without_dots(rgb, gone), _grown(gone, _RIM_PX))


def add_dot(rgb: U8, spots: Mask, rng: np.random.Generator) -> Edited:
    """A press with a copy of one of its marker dots between the others. Errors: DatasetError for no room."""
    numbers = dots(rgb)
    count = int(numbers.max())
    room = _places(spots & ~_grown(numbers > 0, _APART_PX), "room for another marker dot")
    if not count:
        raise DatasetError("the press has no marker dot to copy; leave it out")
    shape = _grown(numbers == 1 + rng.integers(count), _RIM_PX)
    # The dot darkens the place where it is added by the same share, in all colours: a dark colour alone is noise.
    share = (rgb.sum(axis=2) + 1.0) / (without_dots(rgb, shape).sum(axis=2) + 1.0)
    rows, columns = np.nonzero(shape)
    row, column = room[rng.integers(len(room))]
    rows_to, columns_to = rows - int(rows.mean()) + row, columns - int(columns.mean()) + column
    added, mask = rgb.copy(), np.zeros(shape.shape, np.bool_)
    is_in = (rows_to >= 0) & (rows_to < len(rgb)) & (columns_to >= 0) & (columns_to < rgb.shape[1])
    to, source = (rows_to[is_in], columns_to[is_in]), (rows[is_in], columns[is_in])
    added[to] = np.clip(np.round(rgb[to] * np.minimum(share[source], 1)[:, None]), 0, 255).astype(np.uint8)
    mask[to] = True
    return Edited(added, mask)
