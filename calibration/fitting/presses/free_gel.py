"""The free gel, estimated from the presses themselves, and whether a picture of it belongs to them.

Where presses lie apart most of them leave a place free, and the median of these is the gel. Where all touch a place the
light is continued from its surroundings: without a part a GelSight's light is smooth, on six units a polynomial of the
fourth degree to 2 to 4 levels in the median. Compared with pictures of the free gel estimates differ by 1.0 to 1.6
levels in the median where balls lie anywhere, by 1.5 to 3.2 on parts in a fixture that cover 15 to 46 % of the view,
and nowhere by as much as a touch; of a finger on a marker gel by 10.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.core.arrays import F32, F64, U8, Mask
from edge.core.contact.mask import imprint_strength, largest_colour, squared_distance, touched_mask
from edge.core.contact.reference import Reference, View, fit_levels
from edge.core.contact.relief import fine_structure
from edge.core.contact.settings import ContactSettings
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.marker_dots import MarkerDots, find_marker_dots

__all__ = ["FreeGel", "estimate_free_gel", "find_common_dots", "measure_strengths", "view_of"]

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
    if float(np.median([largest_colour(rgb) - ~largest_colour(~rgb) for rgb in some])) < _LEAST_COLOUR:
        return None
    lattices = [dots for rgb in some if (dots := find_marker_dots(rgb, pixels_per_mm)) is not None]
    sizes = np.array([(dots.apart_px, dots.width_px) for dots in lattices])
    if len(lattices) < len(some) or np.any(np.ptp(sizes, axis=0) > _ALIKE * sizes.mean(axis=0)):
        return None
    first = max(lattices, key=lambda dots: len(dots.places))
    shifts = np.stack([first.find_shifts(rgb) for rgb in pictures])
    is_seen = ~np.isnan(shifts).all(axis=(0, 2))
    places = first.places.copy()
    places[is_seen] += np.nanmedian(shifts[:, is_seen], axis=0)
    return replace(first, places=np.round(places, 2))


def dot_light(dots: MarkerDots, pictures: Sequence[U8]) -> F32:
    """Compute what share of the light the dots leave, at their places in most presses, float32 (h, w, 3).

    Each press is moved back by the shift of its dots; one of another gel, without dots, tells nothing.
    """
    shifts = [(rgb, dots.find_shifts(rgb)) for rgb in pictures]
    moved = [_move_back(dots, rgb, shift) for rgb, shift in shifts if not np.isnan(shift).all()]
    return np.asarray(np.median(moved, axis=0), np.float32)


def _move_back(dots: MarkerDots, rgb: U8, shifts: F64) -> F32:
    """Return the share of the light in a press, its dots moved to their places, float32 (h, w, 3).

    shifts: of its dots, (n, 2) pixels, NaN where a dot is not seen.
    """
    height, width = rgb.shape[:2]
    share = np.asarray(rgb, np.float32) / np.maximum(dots.fill(rgb), 1)
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


MOST_PRESSES, _FEW_PRESSES, _PRESSES_PX = 48, 12, 48 * 320 * 240
"""Of more presses as many are taken, evenly spread, and of large pictures fewer, for the time that it takes."""

_ROUNDS, _ROWS = 3, 8
_DEGREE = 4
# A place is filled from its surroundings where this share of the presses touches it, and is the median of those that do
# not where so many are left.
_TOUCHED_SHARE, _FREE_SHARE, _FEWEST = 0.4, 0.1, 3
# Smaller areas of the 160x120 view are dots of a marker gel, and stay.
_DOT_PX = 150
# Structure of about a millimetre, in levels: 1.0 to 1.5 on plain free gels and their estimates, 7 to 16 with dots, 2.8
# and more where a texture of 4 levels covers the view.
_COVERED_LEVELS, _NEAR_PX = 2.0, 5
# What surrounds a touched area bends the light too. The light there continues what is known nearby.
_GROWN_PX, _NEARBY_PX = 9, 8.0
# The rim of the view, and the touched share of it from which the light of the gel is a guess.
_RIM_SHARE, _HARDLY_SEEN = 0.1, 0.5
# Where light was continued a right picture differs from the estimate by 4 to 6 levels, root mean square with edges cut,
# and by 0.1 to 0.7 of what it differs from the median press; a picture of a press by 21 to 31, and 0.9 to 2.7.
_SHOWN_LEVELS, _SHOWN_TIMES, _EDGE_LEVELS = 12.0, 0.8, 40.0
# Presses differ where a gently curved part lies that the estimate holds, for they are not equally deep: around what
# they touch, spread of the broad change at nearly all places 0.4 to 1.4 levels on 37 sets with a right estimate, 1.8 to
# 5.5 where it held a lying cylinder, a sphere or a finger. A place that few presses bend tells nothing: beside an edge
# that lies anywhere the gel bends, and a flat top looks free.
_AROUND_PX, _BROAD_PX, _KNOWN_SHARE, _VARIED_LEVELS, _VARIED_QUANTILE = 15, 3.0, 0.3, 1.6, 0.9
_SD_OF_MAD = 1.48
# What presses show stands out by so many times that spread, 99 % of the places: 10 and more on sets that an estimate
# which held some of the part served as well as a picture, 2.7 to 9 where it held a gently curved part.
_STANDS_OUT, _SHOWN_QUANTILE = 10.0, 0.99
_HOLDS, _HOLDS_SOME = "it may hold the part", "it may hold some of the part"
# Fitting the light: pixels beyond three standard deviations are touched; a residual of this many levels is noise.
_FITS, _SIGMAS, _NOISE = 12, 3.0, 1.5
# Right pictures differ from estimates by up to 1.6 levels in the median, by 2.6 where some of it was filled, and as a
# touch does over at most 2 % of what is free; other lights by 2.6 to 9 levels, other units by 3 to 50.
_FOREIGN_LEVELS, _FOREIGN_BY_FILLED, _FOREIGN_SHARE = 2.5, 4.0, 0.05
# The levels of a colour differ from right pictures to estimates by up to 2 % from the mean of colours on 55 of 56 sets,
# whole and cut; under a light whose colours are exchanged by a twentieth by 5 % and more. A station follows a lamp that
# weakens, and would follow to a picture of another colour too. The gains of `fit_levels` do not tell: where the light
# is even, as in the middle of the gel, noise makes them differ by 15 to 25 %.
_FOREIGN_COLOUR = 0.04


@dataclass(frozen=True, eq=False)
class FreeGel:
    """The gel without contact, as presses or recordings show it."""

    picture: U8
    """uint8 (h, w, 3)."""
    filled: Mask
    """The places that were filled from their surroundings, bool of the view."""
    presses: int = 0
    """From so many presses it was estimated."""
    doubt: str = ""
    """The reason why it may be wrong; empty for none."""
    press: View | None = None
    """The median press, where it was estimated from presses."""

    @classmethod
    def of(cls, pictures: Sequence[U8]) -> "FreeGel":
        """Average pictures of it, uint8 (h, w, 3) each."""
        mean = np.rint(np.mean(pictures, axis=0, dtype=np.float64)).astype(np.uint8)
        return cls(mean, np.zeros(VIEW_SIZE[::-1], np.bool_))

    def __str__(self) -> str:
        share = (
            f", {self.filled.mean():.0%} of it continued from the surroundings" if self.filled.any() else ""
        )
        return f"estimated from {self.presses} presses{share}{self.doubt and ', ' + self.doubt}"

    @property
    def shows_contacts(self) -> bool:
        """Tell whether contacts are known by it, maybe a little too small ones."""
        return self.doubt in ("", _HOLDS_SOME)

    def shows_part(self, picture: U8) -> bool:
        """Tell whether a picture of the free gel shows the part too, where that always lies at one place."""
        if self.doubt or self.press is None or not self.filled.any() or self.find_foreign(picture):
            return False
        reference = Reference(view_of(picture))

        def differs(view: View) -> float:
            squared = squared_distance(reference.difference(view))[self.filled]
            return float(np.sqrt(np.minimum(squared, _EDGE_LEVELS**2).mean()))

        away = differs(view_of(self.picture))
        return away > _SHOWN_LEVELS and away > _SHOWN_TIMES * differs(self.press)

    def find_foreign(self, picture: U8) -> str:
        """Say how a picture of the free gel differs from this one; empty where it does not, or it is not known."""
        if self.doubt:
            return ""
        own, other, free = view_of(self.picture), view_of(picture), ~self.filled
        ratio = np.median((own[free] + 1) / (other[free] + 1), axis=0)
        colour = float(np.abs(ratio / ratio.mean() - 1).max())
        if colour > _FOREIGN_COLOUR:
            return f"differs by {colour:.0%} in a colour: another light, gel or sensor"
        difference = Reference(own).difference(other)
        levels = float(np.median(np.sqrt(squared_distance(difference)[free])))
        share = float(touched_mask(difference)[free].mean())
        most = _FOREIGN_BY_FILLED if self.filled.any() else _FOREIGN_LEVELS
        if levels <= most and share <= _FOREIGN_SHARE:
            return ""
        touch = "something touches the gel in it, or " if levels <= most else ""
        return (
            f"differs by {levels:.1f} levels around the parts, over {share:.0%} as a touch does: {touch}another light, "
            "gel or sensor"
        )


def view_of(picture: U8 | F32) -> View:
    """Return a picture as contact detection sees it."""
    return np.asarray(cv2.resize(picture, VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)


def estimate_free_gel(pictures: Sequence[U8], pixels_per_mm: float) -> FreeGel:
    """Estimate the free gel from pictures of presses, uint8 (h, w, 3) each.

    The dots of a marker gel are filled for it, and put back at their places in most presses.
    """
    height, width = pictures[0].shape[:2]
    most = max(_FEW_PRESSES, min(MOST_PRESSES, _PRESSES_PX // (height * width)))
    rows = np.linspace(0, len(pictures) - 1, min(len(pictures), most)).round().astype(int)
    some = [pictures[k] for k in rows]
    dots = find_common_dots(some, pixels_per_mm)
    plain = some if dots is None else [dots.fill(picture) for picture in some]
    views = [view_of(picture) for picture in plain]
    gel = np.median(plain, axis=0).astype(np.float32)
    for number in range(_ROUNDS):
        gel = gel if number == 0 else _median_of_free(plain, views, gel)
        gel, filled = _fill(gel, views)
    doubt = _doubt(gel, filled, views)
    if dots is not None:
        gel *= dot_light(dots, some)
    picture = np.clip(np.rint(gel), 0, 255).astype(np.uint8)
    return FreeGel(picture, filled, len(pictures), doubt, np.median(views, axis=0).astype(np.float32))


def _doubt(gel: F32, filled: Mask, views: Sequence[View]) -> str:
    """Say why an estimate may be wrong; empty for no reason."""
    if filled[_rim(filled.shape)].mean() > _HARDLY_SEEN:
        return "rim not seen"
    reference = view_of(gel)
    near = np.sqrt(cv2.blur(squared_distance(fine_structure(reference)), (_NEAR_PX, _NEAR_PX)))
    if float(np.median(near[~filled[::2, ::2]])) > _COVERED_LEVELS:
        return "dots or parts all over it"
    differences = [Reference(reference).difference(view) for view in views]
    masks = [touched_mask(difference) for difference in differences]
    spread = _variation(differences, masks)
    if np.median([mask.mean() for mask in masks]) < ContactSettings.on_area:
        return _HOLDS
    if spread < _VARIED_LEVELS:
        return ""
    shown = [
        np.quantile(np.sqrt(squared_distance(difference)), _SHOWN_QUANTILE) for difference in differences
    ]
    return _HOLDS_SOME if np.median(shown) >= _STANDS_OUT * spread else _HOLDS


def _variation(differences: Sequence[View], masks: Sequence[Mask]) -> float:
    """Measure by how many levels presses differ from one another where they are free: 1.48 median deviations."""
    around = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
    free = np.stack([cv2.dilate(mask.astype(np.uint8), around)[::2, ::2] == 0 for mask in masks])
    broad = np.stack(
        [cv2.GaussianBlur(difference, (0, 0), _BROAD_PX)[::2, ::2] for difference in differences]
    )
    known = free.sum(axis=0) >= max(_FEWEST, _KNOWN_SHARE * len(free))
    if not known.any():
        return 0.0
    levels = np.where(free[:, known, None], broad[:, known], np.float32(np.nan))
    spread = _SD_OF_MAD * np.nanmedian(np.abs(levels - np.nanmedian(levels, axis=0)), axis=0).max(axis=1)
    return float(np.quantile(spread, _VARIED_QUANTILE))


def _fill(gel: F32, views: Sequence[View]) -> tuple[F32, Mask]:
    """Continue the light into the places that most presses touch, and return these too."""
    seen = view_of(gel)
    weights = _fit_light(seen)
    light = _light(weights, seen.shape[:2])
    touching = np.mean([touched_mask(Reference(light).difference(view)) for view in views], axis=0)
    _, labels, areas, _ = cv2.connectedComponentsWithStats((touching > _TOUCHED_SHARE).astype(np.uint8))
    is_part = areas[:, cv2.CC_STAT_AREA] >= _DOT_PX
    is_part[0] = False
    filled = cv2.dilate(is_part[labels].astype(np.uint8), np.ones((_GROWN_PX, _GROWN_PX), np.uint8))
    known = (filled == 0).astype(np.float32)[..., None]
    near = cv2.GaussianBlur(known, (0, 0), _NEARBY_PX)[..., None]
    rest = cv2.GaussianBlur((seen - light) * known, (0, 0), _NEARBY_PX) / (near + 1e-3)
    size = (gel.shape[1], gel.shape[0])
    share = cv2.resize(cv2.GaussianBlur(filled.astype(np.float32), (0, 0), 2), size)[..., None]
    share = np.minimum(2 * share, 1)
    continued = _light(weights, gel.shape[:2]) + cv2.resize(rest, size)
    mixed = np.asarray((1 - share) * gel + share * continued, np.float32)
    return mixed, filled > 0


def _median_of_free(pictures: Sequence[U8], views: Sequence[View], gel: F32) -> F32:
    """Take of each pixel the median of the presses that do not touch it, at the gel's level; the gel where few do."""
    reference, size = view_of(gel), (gel.shape[1], gel.shape[0])
    levels = [fit_levels(view, reference) for view in views]
    touching = [
        touched_mask(level.applied(view) - reference) for level, view in zip(levels, views, strict=True)
    ]
    grown = np.ones((_GROWN_PX, _GROWN_PX), np.uint8)
    masks = [
        cv2.resize(cv2.dilate(mask.astype(np.uint8), grown), size, interpolation=cv2.INTER_NEAREST) > 0
        for mask in touching
    ]
    medians = gel.copy()
    for top in range(0, len(gel), _ROWS):  # a few rows at a time, for the memory
        rows = slice(top, top + _ROWS)
        lines = np.stack(
            [level.applied(p[rows].astype(np.float32)) for level, p in zip(levels, pictures, strict=True)]
        )
        hidden = np.stack([mask[rows] for mask in masks])
        free = len(masks) - hidden.sum(axis=0)
        lines[hidden] = np.inf
        middle = np.take_along_axis(np.sort(lines, axis=0), (free // 2)[None, ..., None], axis=0)[0]
        enough = free >= max(_FEWEST, _FREE_SHARE * len(masks))
        medians[rows][enough] = middle[enough]
    return medians


def _terms(shape: tuple[int, ...]) -> F64:
    """Return the polynomial's terms at each pixel of (h, w), (h, w, terms)."""
    y, x = ((np.arange(size) + 0.5) / size * 2 - 1 for size in shape[:2])
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    return np.asarray(np.stack([np.multiply.outer(y**j, x**i) for i, j in powers], axis=-1), np.float64)


def _light(weights: F64, shape: tuple[int, ...]) -> F32:
    return np.asarray(_terms(shape) @ weights, np.float32)


def _fit_light(view: View) -> F64:
    """Fit the polynomial, (terms, 3), to what is not touched, from the rim or everywhere: what explains more."""
    terms = _terms(view.shape)[::2, ::2]
    terms, levels = terms.reshape(-1, terms.shape[-1]), view[::2, ::2].reshape(-1, 3).astype(np.float64)
    fits = []
    for kept in (_rim(view.shape)[::2, ::2].ravel(), np.ones(len(terms), np.bool_)):
        for _ in range(_FITS):
            known = terms[kept]  # few terms over few digits: the normal equations are exact enough, and fast
            weights = np.asarray(np.linalg.lstsq(known.T @ known, known.T @ levels[kept])[0], np.float64)
            away = np.abs(terms @ weights - levels).max(axis=1)
            now = away < _SIGMAS * max(_SD_OF_MAD * float(np.median(away[kept])), _NOISE)
            if np.array_equal(now, kept) or now.sum() < 3 * terms.shape[1]:
                break
            kept = now
        fits.append((float(kept.mean()), weights))
    return max(fits, key=lambda one: one[0])[1]


def _rim(shape: tuple[int, ...]) -> Mask:
    rim = np.ones(shape[:2], np.bool_)
    down, across = (round(_RIM_SHARE * size) for size in shape[:2])
    rim[down:-down, across:-across] = False
    return rim


def measure_strengths(views: Sequence[U8], free: View) -> tuple[float, ...]:
    """Measure how strong each imprint is, as the gateway does. views: uint8 (120, 160, 3)."""
    reference = Reference(free)
    return tuple(
        imprint_strength(squared_distance(reference.difference(view.astype(np.float32)))) for view in views
    )
