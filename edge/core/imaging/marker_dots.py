"""The dots of a marker gel, taken out of a picture of a press.

Dots move with the gel's shear, so two presses of one part show them at different places, and a detector takes that for
damage. They are found in the free gel, found again in each press as dark blobs near where they are expected, and filled
from what surrounds them. What lies under a dot is not seen, and nothing is judged there. A dot that is not found where
its neighbours are says that something hides it: its place is drawn dark, which no sound press shows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, U8, Mask

__all__ = ["MarkerDots", "find_marker_dots", "shows_marker_dots"]

# On four real marker gels a dot is 0.7 to 0.95 mm wide, its centre darker than its surroundings by 48 to 62 % in all
# colours, and its next neighbours are 1.7 to 2.1 mm away, alike within 10 %.
_SURROUNDINGS_MM, _DARKER = 1.5, 0.3
_LARGER: Final = 2.5
_WIDTH_MM: Final = (0.3, 1.4)
_APART: Final = (0.75, 1.25)
# Of the dots on a gel these shares must have neighbours at that distance and in the lattice's directions, and cover the
# region. Free gels without dots have none, grids of balls in a coloured picture of a press neither.
_REGULAR, _IN_LINE, _COVERED = 0.75, 0.8, 0.6
_FEWEST: Final = 12
# Within this many distances lie the next dots, those on the diagonal too.
_DIAGONAL: Final = 1.6
# Of its width a dot's rim, out of focus and with a coloured fringe.
_RIM: Final = 0.25
# A dot may look this many times as large as usual where a part stretches or hides it.
_SIZE: Final = (0.25, 2.2)
# The largest dot of the learnt presses times this is the largest of any press.
_LARGEST: Final = 1.2
# A learnt press hardly shows a dot that is smaller than this. At a steep edge of a real finger dots shrink to 0.27, and
# each of the next eight frames misses one; those of sound presses without such an edge are 0.75 and larger.
_HARDLY: Final = 0.5
# How far from where its neighbours are shifted to a dot is looked for, in distances between dots. Dots that moved by
# more than half of that distance are reached from round to round, over neighbours that moved less.
_REACH, _ROUNDS = 0.3, 6


@dataclass(frozen=True, eq=False)
class MarkerDots:
    """The dots of a marker gel in the inspected region."""

    places: F64
    """Centres on the free gel, float64 (n, 2), x and y in pixels of the region; also those that shear may bring in."""
    apart_px: float
    """Distance of next neighbours."""
    width_px: float
    darker: float
    """Share of the light by which a pixel of a dot is darker than the brightest around it."""
    largest: float | None = None
    """Area of the largest dot of a press, in discs of that width: a larger dark blob is none, and a dot that is not
    seen is drawn dark. None where learnt presses miss dots or nearly do, or it was not learnt: neither is done."""

    def __post_init__(self) -> None:
        if self.places.ndim != 2 or self.places.shape[1] != 2 or not len(self.places):
            raise ValueError(f"places of dots are (n, 2), found {self.places.shape}")
        if not (0 < self.width_px < self.apart_px and 0 < self.darker < 1):
            raise ValueError(
                f"dots are narrower than they lie apart, and darker lies in (0, 1): found {self.width_px}, "
                f"{self.apart_px}, {self.darker}"
            )

    def __str__(self) -> str:
        hidden = min(1.0, _disc((1 + 2 * _RIM) * self.width_px) / self.apart_px**2)
        return (
            f"{self.width_px:.0f} pixels wide, {self.apart_px:.0f} apart; they are filled from their surroundings, and "
            f"nothing is judged under them, {hidden:.0%} of the gel"
        )

    def fill(self, rgb: U8) -> U8:
        """Return a picture with its dots filled from their surroundings, uint8 (h, w, 3); other pixels are kept.

        Errors: ValueError for another shape or dtype.
        """
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
            raise ValueError(f"a picture is uint8 (h, w, 3), found {rgb.dtype} {rgb.shape}")
        blobs = self._blobs(rgb)
        seen, centres = self._match(blobs.centres)[1:]
        hidden = self._hide(blobs, seen)
        filled = rgb.copy()
        filled[hidden] = np.rint(_continue_into(rgb, hidden)[hidden])
        if self.largest is None:
            return filled
        absent = np.zeros(hidden.shape, np.uint8)
        for x, y in self._missing(centres, rgb.shape[:2]):
            cv2.circle(absent, (round(x), round(y)), round(self.width_px / 2), 1, cv2.FILLED)
        dark = filled[absent > 0] * max(0.0, 1 - 2 * self.darker)
        filled[absent > 0] = np.rint(dark)
        return filled

    def learn(self, presses: Sequence[U8]) -> "MarkerDots":
        """Learn from sound presses, uint8 (h, w, 3) each, how large a dot looks, and whether each shows all well."""
        largest = 0.0
        for rgb in presses:
            blobs = self._blobs(rgb)
            _, seen, centres = self._match(blobs.centres)
            shares = (blobs.areas / _disc(self.width_px))[seen][~blobs.is_cut[seen]]
            if len(self._missing(centres, rgb.shape[:2])) or shares.min(initial=1) < _HARDLY:
                return replace(self, largest=None)
            largest = max(largest, float(shares.max(initial=0)))
        return replace(self, largest=min(_SIZE[1], round(_LARGEST * largest, 3)) or None)

    def find(self, rgb: U8) -> Mask:
        """Find the dots of a picture with their rims, bool (h, w). rgb: uint8 (h, w, 3).

        A dot is one dark blob near its place, shifted about as its neighbours are. So a further dark blob is none.
        """
        blobs = self._blobs(rgb)
        return self._hide(blobs, self._match(blobs.centres)[1])

    def _hide(self, blobs: "_Blobs", seen: NDArray[np.int64]) -> Mask:
        is_dot = np.zeros(len(blobs.areas), np.bool_)
        is_dot[seen] = True
        side = 2 * max(1, round(_RIM * self.width_px)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        return np.asarray(cv2.dilate(blobs.mask(is_dot), disc) > 0)

    def find_shifts(self, rgb: U8) -> F64:
        """Find how far each dot of a picture lies from its place, float64 (n, 2), NaN where it is not seen."""
        blobs, shifts = self._blobs(rgb), np.full(self.places.shape, np.nan)
        dots, seen, _ = self._match(blobs.centres)
        shifts[dots] = blobs.centres[seen] - self.places[dots]
        return shifts

    def _blobs(self, rgb: U8) -> "_Blobs":
        """Find the dark blobs that may be dots."""
        blobs = _Blobs.of(_dark(rgb, 2 * self.width_px, self.darker))
        low, high = (share * _disc(self.width_px) for share in (_SIZE[0], self.largest or _SIZE[1]))
        return blobs.choose((blobs.areas < high) & (blobs.is_cut | (blobs.areas > low)))

    def _match(self, centres: F64) -> tuple[NDArray[np.int64], NDArray[np.int64], F64]:
        """Return which dots are seen, which blobs they are, by the blobs' centres, float64 (m, 2), and where the dots
        that are not seen should be, float64 (k, 2)."""
        if not len(centres):
            return np.zeros(0, np.int64), np.zeros(0, np.int64), self.places
        rows = np.arange(len(self.places))
        nearest = _distances(self.places, centres).argmin(axis=1)
        common = np.median(centres[nearest] - self.places, axis=0)
        shift, is_near = common, rows < 0
        for _ in range(_ROUNDS):
            distance = _distances(self.places + shift, centres)
            nearest = distance.argmin(axis=1)
            is_near = distance[rows, nearest] < _REACH * self.apart_px
            is_near &= distance.argmin(axis=0)[nearest] == rows
            weight = self._nearness * is_near
            moved = weight @ (centres[nearest] - self.places) + 1e-3 * common
            shift = moved / (weight.sum(axis=1, keepdims=True) + 1e-3)
        return rows[is_near], np.asarray(nearest[is_near], np.int64), (self.places + shift)[~is_near]

    def _missing(self, places: F64, shape: tuple[int, ...]) -> F64:
        """Choose the places that lie whole in a picture of (h, w)."""
        inside = (places > self.width_px) & (places < np.array([shape[1], shape[0]]) - self.width_px)
        return places[inside.all(axis=1)]

    @cached_property
    def _nearness(self) -> F64:
        return np.exp(-((_distances(self.places, self.places) / self.apart_px) ** 2))


def find_marker_dots(rgb: U8, pixels_per_mm: float) -> MarkerDots | None:
    """Find the regular dark dots that cover a picture, uint8 (h, w, 3); None where there are none."""
    seen = _find_lattice(rgb, pixels_per_mm)
    if seen is None:
        return None
    inside, places, apart, width = seen
    brightest = _brightest(rgb)
    around = np.maximum(_close(brightest, 2 * width), 1)
    darker = float(np.median(1 - brightest[inside] / around[inside]))
    lattice = np.round(_extend(places, apart, rgb.shape[:2]), 2)
    return MarkerDots(lattice, round(apart, 2), round(width, 2), round(darker / 2, 3))


def shows_marker_dots(rgb: U8, pixels_per_mm: float) -> bool:
    """Tell whether regular dark dots cover a picture, uint8 (h, w, 3)."""
    return _find_lattice(rgb, pixels_per_mm) is not None


def _find_lattice(rgb: U8, pixels_per_mm: float) -> tuple[Mask, F64, float, float] | None:
    """Return where dots are, their centres, how far they lie apart, and their width; None for no lattice."""
    blobs = _Blobs.of(_dark(rgb, _SURROUNDINGS_MM * pixels_per_mm, _DARKER))
    low, high = (_disc(width * pixels_per_mm) for width in _WIDTH_MM)
    is_dot = (blobs.areas > low) & (blobs.areas < high) & blobs.is_round & ~blobs.is_cut
    if not is_dot.any():
        return None
    usual = float(np.median(blobs.areas[is_dot]))
    is_dot &= (blobs.areas > 0.4 * usual) & (blobs.areas < 2 * usual)
    places, width = blobs.centres[is_dot], math.sqrt(usual * 4 / math.pi)
    apart = _lattice_distance(places, rgb.shape[0] * rgb.shape[1])
    return None if apart is None or apart < width else (blobs.mask(is_dot) > 0, places, apart, width)


def _lattice_distance(places: F64, area_px: int) -> float | None:
    """Return how far neighbours lie apart, in pixels; None where places are no lattice that covers the area."""
    if len(places) < _FEWEST:
        return None
    distance = _distances(places, places)
    np.fill_diagonal(distance, np.inf)
    nearest = np.sort(distance, axis=1)[:, :2]
    apart = float(np.median(nearest))
    low, high = (share * apart for share in _APART)
    is_regular = (nearest[:, 0] > low) & (nearest[:, 1] < high)
    first, other = np.nonzero((distance > low) & (distance < high))
    across, down = (places[other] - places[first]).T
    # Neighbours lie in directions that are alike but for quarter turns.
    in_line = abs(np.exp(4j * np.arctan2(down, across)).mean()) if len(first) else 0.0
    is_lattice = is_regular.mean() > _REGULAR and in_line > _IN_LINE
    return apart if is_lattice and len(places) * apart**2 > _COVERED * area_px else None


def _extend(places: F64, apart: float, shape: tuple[int, ...]) -> F64:
    """Continue a lattice beyond the border of (h, w), and where dots are missing."""
    dots, before = list(places), 0
    while len(dots) > before:
        before, known = len(dots), np.array(dots)
        first, other = np.nonzero(_distances(known, known) < _DIAGONAL * apart)
        new = 2 * known[first] - known[other]
        new = new[(new > -apart).all(axis=1) & (new < np.array([shape[1], shape[0]]) + apart).all(axis=1)]
        for place in new[_distances(new, known).min(axis=1) > 0.6 * apart]:
            if all(math.hypot(*(place - at)) > 0.6 * apart for at in dots[before:]):
                dots.append(place)
    return np.array(dots)


@dataclass(frozen=True, eq=False)
class _Blobs:
    """Connected dark pixels."""

    labels: NDArray[np.int32]
    """0 for none, else the blob's number from 1, (h, w)."""
    boxes: NDArray[np.int32]
    """Left, top, width, height and area of each, (n, 5)."""
    centres: F64
    """x and y, (n, 2)."""

    @classmethod
    def of(cls, dark: U8) -> "_Blobs":
        closed = cv2.morphologyEx(dark, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
        _, labels, boxes, centres = cv2.connectedComponentsWithStats(closed, connectivity=4)
        return cls(np.asarray(labels, np.int32), np.asarray(boxes[1:], np.int32), np.asarray(centres[1:]))

    def choose(self, chosen: Mask) -> "_Blobs":
        """Return these blobs alone, numbered anew."""
        numbers = np.concatenate([[0], np.where(chosen, np.cumsum(chosen), 0)]).astype(np.int32)
        return _Blobs(numbers[self.labels], self.boxes[chosen], self.centres[chosen])

    @property
    def areas(self) -> NDArray[np.int32]:
        return self.boxes[:, cv2.CC_STAT_AREA]

    @property
    def is_round(self) -> Mask:
        width, height = self.boxes[:, cv2.CC_STAT_WIDTH], self.boxes[:, cv2.CC_STAT_HEIGHT]
        is_even = np.maximum(width, height) < 1.8 * np.minimum(width, height)
        return np.asarray(is_even & (self.areas > 0.6 * math.pi / 4 * width * height))

    @property
    def is_cut(self) -> Mask:
        """Cut by the border."""
        left, top, width, height, _ = self.boxes.T
        down, across = self.labels.shape
        return np.asarray((left == 0) | (top == 0) | (left + width == across) | (top + height == down))

    def mask(self, chosen: Mask) -> U8:
        """Return where these blobs are, 0 or 1, (h, w)."""
        return np.concatenate([[False], chosen]).astype(np.uint8)[self.labels]


def _dark(rgb: U8, surroundings_px: float, darker: float) -> U8:
    """Find what is darker than its surroundings, 0 or 1, (h, w).

    These are the brightest nearby, or the mean of a larger area where that is less: beside a bright edge of the part
    a groove is as dark as a dot, and not of the light of the gel.
    """
    brightest, side = _brightest(rgb), 2 * round(_LARGER * surroundings_px / 2) + 1
    light = cv2.min(_close(brightest, surroundings_px), cv2.blur(brightest, (side, side)))
    return np.asarray(brightest < cv2.convertScaleAbs(light, alpha=1 - darker), np.uint8)


def _brightest(rgb: U8) -> U8:
    """Return each pixel's brightest colour, (h, w). Relief turns colours, and paint darkens all."""
    red, green, blue = cv2.split(rgb)
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def _close(plane: U8, across_px: float) -> U8:
    """Fill what is dark and narrower than this, (h, w)."""
    side = 2 * round(across_px / 2) + 1
    return np.asarray(cv2.morphologyEx(plane, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)), np.uint8)


def _disc(width_px: float) -> float:
    """Return the area of a disc."""
    return math.pi / 4 * width_px**2


def _continue_into(rgb: U8, hidden: Mask) -> F32:
    """Continue a picture smoothly into what is hidden, float32 (h, w, 3), which holds only there.

    Pull and push: each hidden place has the mean of what is known around it, at the finest scale that knows any. Ref:
    Gortler et al., The Lumigraph, SIGGRAPH 1996.
    """
    known = (~hidden).astype(np.float32)
    # The fourth plane is what share of a place is known.
    levels = [np.asarray(cv2.merge([*cv2.split(rgb * known[..., None]), known]), np.float32)]
    while max(levels[-1].shape[:2]) > 1:
        height, width = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, np.float32))
    picture = levels[-1] / np.maximum(levels[-1][..., 3:], np.float32(1e-6))
    for finer in levels[-2:0:-1]:
        coarse = np.asarray(cv2.resize(picture, finer.shape[1::-1]), np.float32)
        picture = finer + coarse * (1 - finer[..., 3:])
    return np.asarray(cv2.resize(picture, hidden.shape[::-1])[..., :3], np.float32)


def _distances(one: F64, other: F64) -> F64:
    """Return the distances of places, float64 (n, m)."""
    across, down = (one[:, None, k] - other[None, :, k] for k in (0, 1))
    return np.asarray(np.hypot(across, down), np.float64)
