"""Relief: the fine structure of an imprint, which shows a light or soft contact before a large area has changed.

Colours that vary over a millimetre or two come from an imprint; slower variation is light. All of it is measured on the
half-size view, where the noise of single pixels is averaged out. By relief and touch together is known how far the part
reaches in a press: what lies beyond that, and beyond where it is expected, is the gel's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import F32, U8, Mask
from edge.core.contact.mask import squared_distance, touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.settings import ContactSettings
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.region import Region

__all__ = [
    "Relief",
    "ReliefOfReference",
    "find_contact",
    "find_expected_reach",
    "reach",
    "reach_beside_marks",
    "with_relief",
]

# Half-size pixels of 0.23 mm on a Mini: structure finer than 7 of them passes, and its energy is taken over 5.
_BAND_PX = 7
_NEAR_PX = 5
# Structure of the reference itself (markers, dust) moves a little with the gel: relief must exceed this share of it.
_OWN_SHARE = 0.5
# Where noise is strong, relief must exceed this many times what the quietest view shows.
_NOISE_TIMES = 2.5
# Markers have most of the energy, in less than a third of the view: this quantile of it is an imprint's.
_BESIDE_MARKERS = 0.7
# Energy below which two pictures have as good as no structure, levels squared: what noise alone gives.
_NOISE_ENERGY = 4.0

Energy = F32
"""float32 (60, 80), levels squared, summed over the colours."""


def fine_structure(view: View) -> View:
    """Return what varies within about a millimetre: float32 (h / 2, w / 2, 3), signed levels."""
    height, width = view.shape[:2]
    half = cv2.resize(view, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(half - cv2.blur(half, (_BAND_PX, _BAND_PX)), np.float32)


def _nearby(energy: Energy) -> Energy:
    return np.asarray(cv2.blur(energy, (_NEAR_PX, _NEAR_PX)), np.float32)


class ReliefOfReference:
    """The fine structure of one reference, kept so that each view costs one filter.

    It learns the noise of the views from the quietest of them, for a wide contact has structure all over.
    """

    def __init__(self, view: View) -> None:
        self._quiet = float("inf")
        self.structure = fine_structure(view)
        self.energy = squared_distance(self.structure)
        self._own = _OWN_SHARE**2 * _nearby(self.energy)

    def of(self, difference: View, light_levels: float) -> "Relief":
        """The relief that a view adds. difference: float32 (h, w, 3), view minus reference, at its level."""
        added = fine_structure(difference)
        near = _nearby(squared_distance(added))
        usual = float(np.partition(near, near.size // 2, axis=None)[near.size // 2])
        self._quiet = min(self._quiet, usual)
        bound = max(light_levels**2, _NOISE_TIMES**2 * self._quiet)
        mask = near > np.maximum(self._own, np.float32(bound))
        return Relief(added, mask, float(np.sqrt(near[mask]).sum()) / mask.size, self)


@dataclass(frozen=True, eq=False)
class Relief:
    """What one view adds to a reference."""

    added: View
    """Signed structure."""
    mask: Mask
    """bool (h / 2, w / 2), where the structure is an imprint's."""
    level: float
    """How strong it is there, root mean square of a millimetre, averaged over the whole view, levels."""
    reference: ReliefOfReference

    @cached_property
    def area(self) -> float:
        """The share of the view with relief."""
        return float(np.count_nonzero(self.mask)) / self.mask.size

    def gain(self, mask: Mask) -> float:
        """Has the view more structure than the reference (positive), or less, where they differ? A log ratio.

        A part that presses adds structure; a reference that was learnt from a pressed gel has more of it than the free
        gel. On public frames of balls it is 1.4 to 2.7 for a press, and the same negative when the two are exchanged.
        On a simulated gel with markers it is 0.8 and more for parts with edges, and near 0 for smooth ones. mask: bool
        (h, w) of the view.
        """
        rows, columns = self.mask.shape
        where = cv2.resize(mask.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST) > 0
        where |= self.mask
        if not where.any():
            return 0.0
        seen = np.quantile(squared_distance(self.added + self.reference.structure)[where], _BESIDE_MARKERS)
        learnt = np.quantile(self.reference.energy[where], _BESIDE_MARKERS)
        return float(np.log((seen + _NOISE_ENERGY) / (learnt + _NOISE_ENERGY)))


def with_relief(mask: Mask, relief: Relief, on_area: float) -> Mask:
    """The place of a contact that is too light to have an area, from its relief: bool (h, w), as `mask`."""
    if relief.area < on_area or np.count_nonzero(mask) >= on_area * mask.size:
        return mask
    height, width = mask.shape
    seen = cv2.resize(relief.mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(mask | (seen > 0), np.bool_)


# 0.5 mm of the 160x120 view around what is touched: a smooth contact fades out without relief. Relief is taken over a
# window of 1.1 mm, so it reaches as far by itself.
_AROUND: Final = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
# One point that is pressed shows relief in 25 cells or more; noise and faint specks show it in fewer.
_CLEAR: Final = np.ones((3, 3), np.uint8)
# Where half of the nominal presses have contact, a press without is missing something.
_EXPECTED_SHARE: Final = 0.5


def reach(touched: Mask, relief: Relief) -> Mask:
    """Find where the part touches the gel or bends it, bool (h, w) of the view.

    A burr beside the part shows relief there. A speck on the gel that nothing presses is much fainter.
    """
    rows, columns = touched.shape
    clear = cv2.morphologyEx(relief.mask.astype(np.uint8), cv2.MORPH_OPEN, _CLEAR)
    bent = cv2.resize(clear, (columns, rows), interpolation=cv2.INTER_NEAREST)
    return np.asarray(np.maximum(cv2.dilate(touched.astype(np.uint8), _AROUND), bent) > 0)


def reach_beside_marks(touched: Mask, relief: Relief, level: View, free: View, near: Mask) -> Mask:
    """Find the reach as `reach` does; near the marks of the free gel by what the press adds to the gel as it was just
    before, which has them too.

    level, free: the press and the gel before it, float32 (h, w, 3). near: around the marks, bool (h, w).
    """
    if not near.any():
        return reach(touched, relief)
    added = level - free
    relief_added = relief.reference.of(added, ContactSettings.light_levels)
    return np.asarray(np.where(near, reach(touched_mask(added), relief_added), reach(touched, relief)))


def find_expected_reach(
    presses: Sequence[U8],
    free: U8 | None,
    usual: F32 | None,
    region: Region,
    size: tuple[int, int],
    prepare: Callable[[U8], U8] = lambda rgb: rgb,
) -> Mask | None:
    """Find where nominal presses reach, bool (h, w) of the region; None where nothing is known of them.

    presses: nominal ones, uint8 (h, w, 3) of the region in a picture of `size` (width, height). free: the view of the
    free gel, uint8 (120, 160, 3). usual: the mean contact of nominal presses over the region, in cells. Either may be
    None. prepare: does to a picture of the region what was done to the presses.
    """
    expected = np.zeros((region.height, region.width), bool)
    if usual is not None:
        cells = (usual >= _EXPECTED_SHARE * usual.max()).astype(np.uint8)
        expected |= _resize(cells, expected.shape) > 0
    if free is not None and presses:
        small = _small(expected.shape, size)
        whole = np.asarray(cv2.resize(free, size), np.uint8)
        gel = Reference(_view(prepare(region.crop(whole)), small))
        structure = ReliefOfReference(gel.view)
        for press in presses:
            added = gel.difference(_view(press, small))
            press_reach = reach(touched_mask(added), structure.of(added, ContactSettings.light_levels))
            expected |= _resize(press_reach.astype(np.uint8), expected.shape) > 0
    return expected if expected.any() else None


def find_contact(press: U8, free: U8, size: tuple[int, int]) -> Mask:
    """Find where a press touches the gel, bool (h, w), without what lies around it; where its relief is, if it is too
    light to have an area. press, free: of the region in a picture of `size` (width, height), uint8 (h, w, 3)."""
    small = _small(press.shape, size)
    gel = Reference(_view(free, small))
    added = gel.difference(_view(press, small))
    contact = touched_mask(added)
    if not contact.any():
        relief = ReliefOfReference(gel.view).of(added, ContactSettings.light_levels).mask.astype(np.uint8)
        contact = cv2.morphologyEx(relief, cv2.MORPH_OPEN, _CLEAR) > 0
    return _resize(contact.astype(np.uint8), press.shape[:2]) > 0


def _small(region: tuple[int, ...], size: tuple[int, int]) -> tuple[int, int]:
    """(h, w) of a region (h, w) in the view."""
    sides = (region[0] * VIEW_SIZE[1] / size[1], region[1] * VIEW_SIZE[0] / size[0])
    return max(4, round(sides[0])), max(4, round(sides[1]))


def _view(rgb: U8, shape: tuple[int, int]) -> F32:
    height, width = shape
    return np.asarray(
        cv2.resize(rgb.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA), np.float32
    )


def _resize(mask: U8, shape: tuple[int, ...]) -> U8:
    return np.asarray(cv2.resize(mask, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST), np.uint8)
