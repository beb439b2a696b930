"""The free gel against another picture of it: its optical wear since it was new, and the light of another picture.

New gels are not clean either, so wear is always a difference to the gel's own first reference. Exposure is removed
first, as for contact; the rest is split into marks (specks, scratches), shading and level. A picture of another light
looks like a contact that is always the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch, largest_colour, touched, touched_mask
from edge.core.contact.reference import Reference, View, fit_levels
from edge.core.contact.relief import ReliefOfReference
from edge.core.contact.settings import ContactSettings
from edge.core.contact.signals import ADDS_STRUCTURE

__all__ = ["Wear", "foreign_free_gel", "foreign_start", "wear"]

# Lengths below are in pixels of a 320x240 picture and scale with the width.
_PIXELS_ACROSS = 320
# Marks are narrower than this many pixels (sigma); wider changes are shading.
_MARK_SIGMA = 6.0
# One pixel of averaging: single-frame noise of sd 2 falls below 0.6.
_NOISE_SIGMA = 1.0
# Levels. Two pictures of one unworn gel weeks apart stay below 3.5; the scratches of a used one reach 4 to 6.
_MARK_LEVELS = 3.5
# A single pixel is noise.
_MIN_MARK_PX = 4
# Longer than this and at least this many times longer than wide is a scratch, anything else a speck.
_SCRATCH_PX = 8.0
_SCRATCH_ASPECT = 3.0
# The image's rim moves by a pixel with the housing and is left out.
_RIM_PX = 4

# What counts as worn out, each alone. Four good units have 1 to 10 specks, a grainy one has over 40.
_WORN_SPECKS = 40
# Scratches with a total length of the picture's width.
_WORN_SCRATCH_LENGTH = 1.0
# Levels of shading after the exposure is taken out: two pictures of one gel differ by 0.4, two gels by 5.
_WORN_SHADING_LEVELS = 10.0
# Automatic exposure alone moves the level by 0.2.
_WORN_LEVEL_CHANGE = 0.5


@dataclass(frozen=True)
class Wear:
    """How much a gel has changed since it was new."""

    index: float
    """0 (as new) to 1 (worn out), that of its worst part."""
    specks: int
    """New compact marks."""
    scratch_length: float
    """Total length of new long marks, in picture widths."""
    shading_levels: float
    """Mean absolute broad change that no exposure explains (coat loss, a weak light on one side)."""
    level_change: float
    """Largest relative change of a channel's mean; exposure moves it too, so judge it with the exposure locked."""


def wear(first: View, now: View) -> Wear:
    """Compare the free gel with its first reference, both float32 (h, w, 3), RGB, 0 to 255, of one size.

    Meant for references, means of some ten still frames, at 320x240; at 160x120 the finest specks are lost. Errors:
    ValueError for two shapes.
    """
    if first.shape != now.shape or first.ndim != 3 or first.shape[2] != 3:
        raise ValueError(
            f"two free-gel pictures have one shape (h, w, 3), found {first.shape} and {now.shape}"
        )
    residual = fit_levels(now, first).applied(now) - first
    scale = first.shape[1] / _PIXELS_ACROSS
    shading = _blurred(residual, _MARK_SIGMA * scale)
    specks, length = _marks(_blurred(residual - shading, _NOISE_SIGMA * scale), scale)
    shading_levels = float(np.abs(shading).mean())
    before, after = (view.mean(axis=(0, 1), dtype=np.float64) for view in (first, now))
    level_change = float(np.max(np.abs(after - before) / np.maximum(before, 1.0)))
    worst = max(
        specks / _WORN_SPECKS,
        length / _WORN_SCRATCH_LENGTH,
        shading_levels / _WORN_SHADING_LEVELS,
        level_change / _WORN_LEVEL_CHANGE,
    )
    return Wear(min(1.0, worst), specks, length, shading_levels, level_change)


def _marks(detail: View, scale: float) -> tuple[int, float]:
    """The number of specks, and the scratches' length in picture widths. detail: signed, levels."""
    far = (largest_colour(np.abs(detail)) > _MARK_LEVELS).astype(np.uint8)
    rim = max(1, round(_RIM_PX * scale))
    far[:rim], far[-rim:], far[:, :rim], far[:, -rim:] = 0, 0, 0, 0
    far = np.asarray(cv2.morphologyEx(far, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    contours, _ = cv2.findContours(far, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    labels = cv2.connectedComponentsWithStats(far, connectivity=8)[2][1:]
    is_mark = labels[:, cv2.CC_STAT_AREA] >= max(1, round(_MIN_MARK_PX * scale * scale))
    lengths = [_scratch_px(np.asarray(c, dtype=np.int32), scale) for c in contours]
    total_px = sum(length for length in lengths if length > 0)
    specks = int(is_mark.sum()) - sum(length > 0 for length in lengths)
    return max(0, specks), total_px / detail.shape[1]


def _scratch_px(contour: NDArray[np.int32], scale: float) -> float:
    """The length of a long thin mark, 0 for any other."""
    (_, sides, _) = cv2.minAreaRect(contour)
    long, short = max(sides) + 1, min(sides) + 1
    return float(long) if long >= _SCRATCH_PX * scale and long >= _SCRATCH_ASPECT * short else 0.0


def _blurred(view: View, sigma: float) -> View:
    return np.asarray(cv2.GaussianBlur(view, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


# Of public pictures of balls, with a free gel of their own light, the touched area is 0.5 to 1.2 times the relief's;
# with one of another light it is 3 and more.
_TIMES_RELIEF: Final = 2.5
# The areas of such presses spread by less than this share of their median: it is the light that is measured.
_SPREAD: Final = 0.25
_FEWEST: Final = 3
# A free gel that differs by a larger share of the view from the one at fit gives a warning.
_FOREIGN_AREA: Final = 0.05


def foreign_free_gel(touches: Sequence[Touch], reliefs: Sequence[float]) -> str | None:
    """The doubt about the free gel's picture, or None. reliefs: shares of the view with an imprint's structure."""
    areas = np.array([touch.area for touch in touches])
    if len(areas) < _FEWEST:
        return None
    area, relief = float(np.median(areas)), float(np.median(reliefs))
    spread = float(np.median(np.abs(areas - area))) / max(area, 1e-6)
    if area < ContactSettings.on_area or area < _TIMES_RELIEF * relief or spread > _SPREAD:
        return None
    return (
        f"the touched area is {area:.0%} of the view and hardly differs between presses, and an imprint shows in "
        f"{relief:.1%} alone: the picture of the free gel is most likely of another light than the presses; take "
        "one under the same light and exposure"
    )


def foreign_start(free: Reference, at_fit: Reference) -> str | None:
    """The difference between a free gel just learnt and the one that the bundle was fitted with; or None."""
    if free.view.shape != at_fit.view.shape:
        return None
    difference = at_fit.difference(free.view)
    mask = touched_mask(difference)
    area = touched(mask).area
    gain = ReliefOfReference(at_fit.view).of(difference, ContactSettings.light_levels).gain(mask)
    if area < _FOREIGN_AREA or gain >= ADDS_STRUCTURE:
        return None
    return (
        f"the free gel differs over {area:.0%} of the view from the one that the bundle was fitted with: another "
        "light, gel or sensor; if presses are rejected or fail without reason, restore the light or fit again"
    )
