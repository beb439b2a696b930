"""What a hand should do with a press: from what a frame shows, against what a bundle knows of its nominal presses."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from edge.core.arrays import Mask
from edge.core.contact.mask import Touch, touched
from edge.core.contact.press_detector import Look
from edge.core.contact.relief import reach
from edge.core.contact.settings import ContactSettings
from edge.core.contact_state import Advice, ContactState
from edge.core.imaging.quality import NominalContact

__all__ = ["Guidance", "guide"]

# A tilt takes this share of the nominal reach away, on one side: its centre is this share of the reach's width from the
# reach's. A press at another place adds as much on the other side as it takes away. Simulated parts that lie upright,
# lighter or deeper, lose up to 0.22 and lie within 0.15; a lean of 3 to 4 degrees of wide ones is told, of narrow ones
# none.
_MISSING_SHARE: Final = 0.08
_SIDE_SHARE: Final = 0.25
_BEYOND_SHARE: Final = 0.5


@dataclass(frozen=True)
class Guidance:
    """One thing to do."""

    advice: Advice
    direction_deg: float | None = None
    """Of shift and tilt: where the contact has to go, or to be pressed more; 0 to the right in the picture, 90 down."""


def guide(
    state: ContactState, look: Look, contact: NominalContact | None, nominal: Mask | None
) -> Guidance | None:
    """Return what to do, None where nothing is sure.

    contact, nominal: where nominal presses touch, and where they reach, bool (h, w) of the view; None where that is not
    known.
    """
    match state:
        case "lift" | "overload":
            return Guidance("lift")
        case "at_rest" | "judged":
            return Guidance("hold")
        case "pressing" | "deep_enough":
            away = _find_side(look, contact, nominal)
            return away or Guidance("hold" if state == "deep_enough" else "deeper")
    return None


def _find_side(look: Look, contact: NominalContact | None, nominal: Mask | None) -> Guidance | None:
    if (
        look.mask is None
        or look.relief is None
        or look.seen is None
        or look.seen.area < ContactSettings.on_area
    ):
        return None
    if contact is not None and (way := _way_back(look.seen.contact, contact)) is not None:
        return Guidance("shift", way)
    return None if nominal is None else _find_untouched(reach(look.mask, look.relief), nominal)


def _way_back(touch: Touch, contact: NominalContact) -> float | None:
    """The direction from a contact whose centre lies outside of those of nominal presses."""
    x, y = (min(max(at, low), high) - at for at, (low, high) in ((touch.x, contact.x), (touch.y, contact.y)))
    return None if x == y == 0 else _degrees(x, y)


def _find_untouched(found: Mask, nominal: Mask) -> Guidance | None:
    """Find one side of the nominal reach that the part does not touch, although it reaches nowhere else instead."""
    missing = nominal & ~found
    lost, total = np.count_nonzero(missing), np.count_nonzero(nominal)
    if lost < _MISSING_SHARE * total or np.count_nonzero(found & ~nominal) > _BEYOND_SHARE * lost:
        return None
    rows, columns = np.nonzero(nominal)
    whole, side = touched(nominal), touched(missing)
    x = (side.x - whole.x) * nominal.shape[1] / (np.ptp(columns) + 1)
    y = (side.y - whole.y) * nominal.shape[0] / (np.ptp(rows) + 1)
    return None if math.hypot(x, y) < _SIDE_SHARE else Guidance("tilt", _degrees(x, y))


def _degrees(x: float, y: float) -> float:
    return round(math.degrees(math.atan2(y, x)) % 360, 1)
