"""The scars of one gel over its presses: the cause of what a press shows, and the places that are not judged."""

from dataclasses import dataclass
from typing import Final, final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View
from edge.core.gel_scars.causes import (
    MOSTLY,
    REACH_PX,
    SEVERAL,
    Blame,
    Cause,
    blame,
    explained,
    together,
    within,
)
from edge.core.gel_scars.free_change import free_change, marks
from edge.core.gel_scars.press import ScoredPress
from edge.core.gel_scars.record import ScarRecord
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["GelScars", "Judged"]

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# What a scar raises around itself is masked up to this distance from the mark, in pixels of the view: 1 mm. On
# simulated gels the map exceeds its limit up to 0.7 mm away.
_HALO_PX: Final = 8
# The mask is 0.25 mm wider than what exceeded: the next press shows the scar slightly larger.
_WIDER: Final = np.ones((5, 5), np.uint8)
# Above the limit by less than it at the peak, and by less than this in the sum over pixels of the view, a press fails
# slightly: a mark that grows slowly has come that far.
_SLIGHT, _SLIGHT_SUM = 1.0, 20.0
# A mark is as it was in quiet presses where this share of its change is not above theirs.
_GROWN: Final = 0.75


@dataclass(frozen=True, eq=False)
class Judged:
    """One press, with the scars known before it.

    masked: bool (h, w) of the map, places that were not judged because of scars. highest: of the map elsewhere.
    blind_mm2: their area, where the press touches; blind_share: of the contact. blame: why the rest exceeded the limit,
    None where it did not. is_new: whether a scar became known.
    """

    masked: Mask
    highest: float
    blind_mm2: float
    blind_share: float
    blame: Blame | None
    is_new: bool


@final
class GelScars:
    """What is known of one gel. first: its first picture, float32 (120, 160, 3), None until it is learnt.

    Its memory does not grow. One thread at a time.
    """

    def __init__(self, record: ScarRecord | None = None, first: View | None = None) -> None:
        self.record = record or ScarRecord.empty((VIEW_SIZE[1], VIEW_SIZE[0]))
        self.first = first

    def judge(
        self, press: ScoredPress, free: View | None, left: View | None = None, *, is_masking: bool = True
    ) -> Judged:
        """One press, in order. free: the gel just before it, left: what the press before added (`free_change`).

        is_masking: False judges known scars too.
        """
        before = self.record.masked
        masked = press.in_map(before) & is_masking
        rest = np.where(masked, -np.inf, press.score_map)
        excess, change = press.excess(), self._change(free, left)
        open_places = press.in_view(np.where(rest > press.limit, np.float32(1), np.float32(0))) > 0
        blames, scars = self._blamed(press, excess, open_places, change)
        touched = np.ones_like(before) if press.contact is None else press.contact
        self.record = self._after(press, excess, scars, change, touched)
        contact = press.in_map(touched)
        blind = masked & contact
        return Judged(
            masked,
            float(rest.max()),
            press.area_mm2(blind),
            float(blind.sum()) / max(1, int(contact.sum())),
            together(blames),
            bool((self.record.masked & ~before).any()),
        )

    def _change(self, free: View | None, left: View | None) -> F32 | None:
        """Of the free gel, in levels; None where it is not known."""
        if free is None or self.first is None or free.shape != self.first.shape:
            return None
        return free_change(self.first, free, left)

    def _after(
        self, press: ScoredPress, excess: F32, scars: Mask, change: F32 | None, touched: Mask
    ) -> ScarRecord:
        """The record with this press. Where the part's place is known it varies, and a press that was quiet with a mark
        says nothing of the next one."""
        shown, exceeds, harmless = press.shown(), excess > 0, None
        if change is not None and press.place_mm is None:
            harmless = np.where(shown & touched & ~_active(exceeds, change), change, np.float32(0))
        return self.record.after(exceeds, shown, scars, press.place_mm, harmless)

    def _blamed(
        self, press: ScoredPress, excess: F32, open_places: Mask, change: F32 | None
    ) -> tuple[list[Blame], Mask]:
        """The cause of every connected place that is not masked completely, and the places to mask from now on."""
        scars = np.zeros(excess.shape, bool)
        blames = []
        marked = None if change is None else marks(change)
        count, labels = cv2.connectedComponents((excess > 0).astype(np.uint8), connectivity=8)
        for number in range(1, count):
            place = labels == number
            if not (place & open_places).any():
                continue
            judged = np.where(place & open_places, excess, np.float32(0))
            causing = (
                None if marked is None or change is None else self._causing(press, judged, marked, change)
            )
            share = None if causing is None else explained(judged, causing, self.record.masked)
            blames.append(blame(share, self.record.repeats(place), _wide_mm(place, press)))
            if blames[-1].cause is Cause.GEL:
                scars |= self._scar(place, causing)
        return blames, scars

    def _causing(self, press: ScoredPress, excess: F32, marked: Mask, change: F32) -> Mask:
        """The marks that may be the cause: one that was there in quiet presses does not cause a clear fail, unless most
        presses of late exceeded there."""
        limit = abs(press.limit)
        if float(excess.max()) <= _SLIGHT * limit and float(excess.sum()) <= _SLIGHT_SUM * limit:
            return marked
        has_grown = change * np.float32(_GROWN) > self.record.harmless
        return np.asarray(marked & (has_grown | within(self.record.often(SEVERAL, MOSTLY), REACH_PX)))

    def _scar(self, place: Mask, marked: Mask | None) -> Mask:
        """Of a place that comes from the gel, what is masked: near its marks, or where it came back."""
        near = self.record.often(SEVERAL)
        if marked is not None:
            near = near | within(marked, _HALO_PX)
        wide = cv2.dilate((place & near).astype(np.uint8), _WIDER)
        return np.asarray(wide > 0)


def _active(exceeds: Mask, change: F32) -> Mask:
    """What exceeded, and every mark that reaches there to its ends: a mark is quiet all along or not at all."""
    near = within(exceeds, REACH_PX)
    marked = marks(change)
    if marked is None:
        return near
    _, labels = cv2.connectedComponents(marked.astype(np.uint8), connectivity=8)
    return np.asarray(near | (marked & np.isin(labels, np.unique(labels[near & marked]))))


def _wide_mm(place: Mask, press: ScoredPress) -> float:
    """The larger side of the box around it."""
    rows, columns = np.nonzero(place)
    per_pixel = [press.size[k] * press.mm_per_pixel[k] / VIEW_SIZE[k] for k in (0, 1)]
    return float(max(np.ptp(columns) * per_pixel[0], np.ptp(rows) * per_pixel[1]))
