"""The scars of one gel over its presses: the cause of what a press shows, and the places that are not judged."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, Mask
from edge.core.contact.reference import View
from edge.core.gel_scars.causes import SEVERAL, blame, doubt, is_explained, remaining, together
from edge.core.gel_scars.free_change import Marks, find_clear_marks, marks
from edge.core.gel_scars.press import ScoredPress
from edge.core.gel_scars.record import ScarRecord
from edge.core.gel_scars.specks import Specks
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.verdict import Blame, Cause

__all__ = ["GelScars", "Judged"]

# What a scar raises around itself is masked up to this distance from the mark, in pixels of the view: 1 mm. On
# simulated gels the map exceeds its limit up to 0.7 mm away.
_HALO_PX: Final = 8
# Dust that is strong shows as an imprint does, up to this distance from its mark: 1.5 mm.
_OWN_REACH_PX: Final = 12
# What a mark shows in a press may be less than it shows on the free gel: these shares of it are tried.
_SHARES: Final = (1.0, 0.7, 0.4)
# The mask is 0.25 mm wider than what exceeded: the next press shows the scar slightly larger.
_WIDER: Final = np.ones((5, 5), np.uint8)
# This many presses in a row that exceed within 1 mm of one place of the gel are said.
_REPEATED: Final = 5


@dataclass(frozen=True)
class Repeated:
    """A place of the gel that exceeded the limit, or that the free gel showed marked, in press after press. x_mm, y_mm:
    from the region's corner."""

    x_mm: float
    y_mm: float
    is_outside: bool
    """No part reaches it."""


@dataclass(frozen=True, eq=False)
class Judged:
    """One press, with the scars known before it."""

    masked: Mask
    """bool (h, w) of the map: places that were not judged, under scars or beyond the part's reach."""
    blind_mm2: float
    """Area under scars where the press touches."""
    blind_share: float
    """The same area as a share of the contact."""
    blame: Blame | None
    """Why the rest exceeded the limit; None where it did not."""
    is_new: bool
    """A scar became known with this press."""
    repeated: Repeated | None = None
    """None where no place exceeded, and none beyond the part was marked, in five presses in a row; known scars are left
    out."""


class _Places(NamedTuple):
    """Connected places of the view, numbered from 1."""

    labels: NDArray[np.int32]
    """The place of each pixel; 0 outside of all."""
    boxes: NDArray[np.int32]
    """A row for each number: (left, top, width, height, area)."""

    @classmethod
    def of(cls, levels: F32) -> "_Places":
        """Find where the levels are above 0."""
        above = (levels > 0).astype(np.uint8)
        if not above.any():
            return cls(np.zeros(above.shape, np.int32), np.zeros((1, 5), np.int32))
        return cls(*cv2.connectedComponentsWithStats(above, connectivity=8)[1:3])  # type: ignore[arg-type]

    def touch(self, places: Mask) -> Mask:
        """Say of each number whether it meets one of these pixels; False for 0."""
        is_met = np.zeros(len(self.boxes), bool)
        is_met[self.labels[places]] = True
        is_met[0] = False
        return is_met


@final
class GelScars:
    """What is known of one gel. first: its first picture, float32 (120, 160, 3), None until it is learnt.

    Its memory does not grow. One thread at a time.
    """

    def __init__(self, record: ScarRecord | None = None, first: View | None = None) -> None:
        self.record = record or ScarRecord.empty((VIEW_SIZE[1], VIEW_SIZE[0]))
        self.first = first
        self._in_a_row = np.zeros((VIEW_SIZE[1], VIEW_SIZE[0]), np.int64)
        self._specks = Specks()
        self.near_marks: Mask = np.zeros((VIEW_SIZE[1], VIEW_SIZE[0]), bool)
        """Where a clear mark of the free gel just before the press may show as if something touched, bool (120, 160).
        """
        self.is_fresh = False
        """Whether the free gel that is judged with next was seen for a moment after a release alone."""
        self._asked: tuple[View | None, View | None, View | None] = (None, None, None)
        self._found: tuple[Marks | None, Marks | None] = (None, None)

    def see_free(self, free: View | None, left: View | None) -> None:
        """Look for clear marks of the free gel as a press begins; it takes both as `judge` does. Where it is not known,
        or has changed all over, none are."""
        first, clear = self.first, None
        if free is not None and first is not None and free.shape == first.shape:
            clear = find_clear_marks(first, free, left)
        self.near_marks = np.zeros_like(self.near_marks) if clear is None else _within(clear, _OWN_REACH_PX)
        if clear is not None:
            self._specks.see(clear)

    @property
    def lasting_specks(self) -> Mask:
        """The marks of the free gel that are said where they lie beyond the reach of the press, bool (120, 160)."""
        return self._specks.lasting

    def judge(
        self, press: ScoredPress, free: View | None, left: View | None = None, *, is_masking: bool = True
    ) -> Judged:
        """Judge one press, in order. free: the gel just before it, left: what the press before added (`marks`).

        is_masking: False judges known scars too.
        """
        before = self.record.masked
        excess = press.excess()
        # A quiet scar hides nothing: it may have been wiped off.
        places = _Places.of(before.astype(np.float32))
        scarred = press.in_map(places.touch(excess > 0)[places.labels]) & is_masking
        excess_places = _Places.of(excess)
        outside, left_out = _outside(press, excess_places)
        masked = scarred | press.in_map(left_out)
        rest = np.where(masked, -np.inf, press.score_map)
        blames, scars, shown = list[Blame](), np.zeros_like(before), press.extent()
        if (beyond := rest > press.limit).any():
            is_open = press.in_view(beyond.astype(np.float32)) > 0 if masked.any() else excess > 0
            blames, scars = self._blame_places(press, np.where(is_open, excess, 0), excess_places, free, left)
        self.record = self.record.after(excess > 0, shown, scars, press.moved_mm)
        repeated = self._find_repeated(press, np.where(before, np.float32(0), excess), shown, outside)
        speck = None if repeated else self._find_speck(press, shown)
        if (
            speck is not None
        ):  # it is left out so that the picture shows it; what exceeds there is judged as ever
            masked = masked | (press.in_map(speck) & (press.score_map <= press.limit))
            repeated = _locate(press, *np.argwhere(speck).mean(axis=0).tolist(), is_outside=True)
        return Judged(
            masked,
            *_blind(press, scarred),
            together(blames),
            bool((self.record.masked & ~before).any()),
            repeated,
        )

    def _find_speck(self, press: ScoredPress, shown: Mask) -> Mask | None:
        """Find the largest mark of the free gel that lies where the part is not, bool (120, 160)."""
        if press.reach is None:
            return None
        places = _Places.of((self.lasting_specks & shown & ~press.reach).astype(np.float32))
        if len(places.boxes) < 2:
            return None
        return np.asarray(places.labels == 1 + int(places.boxes[1:, cv2.CC_STAT_AREA].argmax()))

    def _find_repeated(self, press: ScoredPress, excess: F32, shown: Mask, outside: Mask) -> Repeated | None:
        """Find the place that exceeded in the most presses in a row."""
        if not excess.any():
            self._in_a_row[shown] = 0
            return None
        near = _within(excess > 0, _HALO_PX)
        self._in_a_row = np.where(shown, np.where(near, self._in_a_row + 1, 0), self._in_a_row)
        most = int(self._in_a_row.max())
        here = near & (self._in_a_row == most)
        if most < _REPEATED or not here.any():
            return None
        inside = np.where(here, cv2.distanceTransform(near.astype(np.uint8), cv2.DIST_L2, 5), 0)
        row, column = np.unravel_index(int(inside.argmax()), here.shape)
        # of what exceeds in this press, the nearest
        to_part, to_outside = (
            _measure_distance(places)[row, column] for places in ((excess > 0) & ~outside, outside)
        )
        return _locate(press, float(row), float(column), is_outside=bool(to_part > to_outside))

    def find_marks(self, free: View | None, left: View | None) -> tuple[Marks | None, Marks | None]:
        """Find the marks of the free gel, once for the same pictures, which do not change: first without those that may
        be the rest of the last press, then with them; None where they are not known. It may be asked before the press
        is judged."""
        first = self.first
        if free is None or first is None or free.shape != first.shape:
            return None, None
        asked = first, free, left
        if any(one is not other for one, other in zip(self._asked, asked, strict=True)):
            known = marks(*asked, is_fresh=self.is_fresh)
            self._asked, self._found = asked, (known, marks(*asked) if self.is_fresh else known)
        return self._found

    def _blame_places(
        self, press: ScoredPress, excess: F32, found: _Places, free: View | None, left: View | None
    ) -> tuple[list[Blame], Mask]:
        """Blame every place that exceeds the limit somewhere; return also the places to mask from now on. excess: 0
        where nothing is judged. free, left: as `judge` takes them."""
        known, at_most = self.find_marks(free, left)
        scars = np.zeros(excess.shape, bool)
        numbers = np.flatnonzero(found.touch(excess > 0))
        judged = [np.where(found.labels == n, excess, np.float32(0)) for n in numbers]
        blames, lefts = [], _lefts(press, judged, known)
        if at_most is not known:
            at_least = _lefts(press, judged, at_most)
            lefts = [
                None if one is None or least is None else doubt(one, least)
                for one, least in zip(lefts, at_least, strict=True)
            ]
        for n, share in zip(numbers, lefts, strict=True):
            place = found.labels == n
            blames.append(blame(share, self.record.repeats(place), _wide_mm(found.boxes[n], press)))
            if blames[-1].cause is Cause.GEL:
                scars |= self._scar(place, known)
        return blames, scars

    def _scar(self, place: Mask, known: Marks | None) -> Mask:
        """Choose what is masked of a place that comes from the gel: near its marks, or where it came back."""
        near = self.record.often(SEVERAL)
        if known is not None:
            near = near | _within(known.places, _HALO_PX)
        wide = cv2.dilate((place & near).astype(np.uint8), _WIDER)
        return np.asarray(wide > 0)


def _locate(press: ScoredPress, row: float, column: float, *, is_outside: bool) -> Repeated:
    """Say where a pixel of the view lies in the region."""
    x_px, y_px = (column + 0.5) * press.size[0] / VIEW_SIZE[0], (row + 0.5) * press.size[1] / VIEW_SIZE[1]
    x_mm, y_mm = (
        (x_px - press.region.x) * press.mm_per_pixel[0],
        (y_px - press.region.y) * press.mm_per_pixel[1],
    )
    return Repeated(x_mm, y_mm, is_outside)


def _outside(press: ScoredPress, found: _Places) -> tuple[Mask, Mask]:
    """The places above the limit that lie beyond the part's reach, and with what they raise around them there.

    A place that meets the reach anywhere is judged, all of it.
    """
    above = found.labels > 0
    if press.reach is None or not above.any():
        return (nowhere := np.zeros(above.shape, bool)), nowhere
    met = found.touch(press.reach)[found.labels]
    outside = above & ~met
    return outside, _within(outside, _HALO_PX) & ~met & ~press.reach


def _blind(press: ScoredPress, scarred: Mask) -> tuple[float, float]:
    """Measure how much of the contact lies under scars: in mm2, and as a share."""
    if not scarred.any():
        return 0.0, 0.0
    contact = np.ones_like(scarred) if press.contact is None else press.in_map(press.contact)
    blind = scarred & contact
    return press.area_mm2(blind), int(np.count_nonzero(blind)) / max(1, int(np.count_nonzero(contact)))


def _lefts(press: ScoredPress, judged: list[F32], known: Marks | None) -> list[float | None]:
    """Compute the share of each place that is left without the marks; None where they are not known.

    The press is scored once more only where a mark lies near a place, and with less of the change where that leaves
    much: contact flattens a mark. judged: how far each place is above the limit, float32 (120, 160), 0 elsewhere.
    """
    if known is None:
        return [None] * len(judged)
    near = _within(known.places, _HALO_PX)
    lefts: list[float | None] = [1.0] * len(judged)
    open_ = [k for k, excess in enumerate(judged) if (near & (excess > 0)).any()]
    for share in _SHARES:
        score_map = press.without(known.change * np.float32(share)) if open_ else None
        if score_map is None:
            break
        rest = replace(press, score_map=score_map).excess()
        for k in open_:
            lefts[k] = min(lefts[k] or 0.0, remaining(judged[k], rest))
        open_ = [k for k in open_ if not is_explained(lefts[k])]
    return lefts


def _within(places: Mask, reach_px: float) -> Mask:
    """Pixels at most this far from one of the places, bool (h, w)."""
    return np.asarray(_measure_distance(places) <= reach_px)


def _measure_distance(places: Mask) -> F32:
    """Measure how far each pixel is from the nearest of the places, in pixels, float32 (h, w)."""
    if not places.any():
        return np.full(places.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~places).astype(np.uint8), cv2.DIST_L2, 5))


def _wide_mm(box: NDArray[np.int32], press: ScoredPress) -> float:
    """The larger side of a box, between the centres of its pixels."""
    per_pixel = [press.size[k] * press.mm_per_pixel[k] / VIEW_SIZE[k] for k in (0, 1)]
    return float(max((box[2] - 1) * per_pixel[0], (box[3] - 1) * per_pixel[1]))
