"""Does a picture of the free gel belong to the presses? Another light looks like a contact that is always the same."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.reference import Reference
from edge.core.contact.relief import ReliefOfReference
from edge.core.contact.settings import ContactSettings
from edge.core.contact.signals import ADDS_STRUCTURE

__all__ = ["foreign_free_gel", "foreign_start"]

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
