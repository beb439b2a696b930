"""Checks whether a settled press can be scored. Each reason against it is a value, not an exception."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import BLACK_LEVEL, Touch, largest_colour
from edge.core.printable import score_texts
from edge.core.sentence import Sentence

__all__ = [
    "BLACK_LEVEL",
    "MAX_AGE_S",
    "NominalContact",
    "NominalStrength",
    "Reason",
    "Rejection",
    "check_contact",
    "check_freshness",
    "check_light",
]

# A value of 250 of 255 no longer shows the slope. Steep flanks of real imprints clip in blue and red on far less than
# 5 %.
SATURATED_LEVEL: Final = 250
SATURATED_SHARE: Final = 0.10

MAX_AGE_S: Final = 1.0
"""The age of a frame at which it is not judged any more."""


class Reason(StrEnum):
    """Why a press has no verdict. The values are part of the published payload."""

    BLACK = "black"
    SATURATED = "saturated"
    STALE = "stale"
    OTHER_SENSOR = "other_sensor"
    NO_CONTACT = "no_contact"
    OFF_POSITION = "off_position"
    NO_POSE = "no_pose"
    NOT_SETTLED = "not_settled"
    NO_OVERVIEW = "no_overview"
    NO_PART = "no_part"
    NO_PART_ID = "no_part_id"
    OTHER_PART = "other_part"
    REFERENCE = "reference"
    GEL_PROOF = "gel_proof"
    NO_PLACE = "no_place"
    ALL_IGNORED = "all_ignored"
    FEATURE = "feature"


@dataclass(frozen=True)
class Rejection:
    """A press that cannot be judged."""

    reason: Reason
    text: Sentence
    """For the operator."""


@dataclass(frozen=True)
class NominalContact:
    """Where nominal presses have contact, each (low, high) with a margin: fractions of the picture, as in `Touch`."""

    x: tuple[float, float]
    y: tuple[float, float]
    area: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("x", "y", "area"):
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name} runs from low to high, found {low} to {high}")


@dataclass(frozen=True)
class NominalStrength:
    """How strong the imprints of nominal presses are, levels (`imprint_strength`)."""

    lowest: float
    middle: float
    highest: float

    def __post_init__(self) -> None:
        if not 0 < self.lowest <= self.middle <= self.highest:
            raise ValueError(f"0 < lowest <= middle <= highest is needed, found {self}")


def check_light(rgb: NDArray[np.uint8]) -> Rejection | None:
    """Black or saturated, or None. rgb: uint8 (h, w, 3)."""
    mean = float(rgb.mean(dtype=np.float64))
    if mean < BLACK_LEVEL:
        text = Sentence(
            f"the frame's mean level is {mean:.1f}, at least {BLACK_LEVEL:g} is expected; "
            "check the sensor's light and cable"
        )
        return Rejection(Reason.BLACK, text)
    saturated = float((largest_colour(rgb) >= SATURATED_LEVEL).mean())
    if saturated > SATURATED_SHARE:
        share, saturated_share = score_texts(saturated, SATURATED_SHARE, 0, "%")
        text = Sentence(
            f"{share} of the frame is saturated, at most {saturated_share} is accepted; lower the "
            "exposure or the press depth"
        )
        return Rejection(Reason.SATURATED, text)
    return None


def check_freshness(timestamp_ns: int, now_ns: int) -> Rejection | None:
    """Stale, or None. Both times are monotonic; a frame from the future is also refused."""
    age_s = (now_ns - timestamp_ns) / 1e9
    if 0 <= age_s <= MAX_AGE_S:
        return None
    text = Sentence(
        f"the frame is {age_s:.2f} s old, at most {MAX_AGE_S:g} s is accepted; check the machine's load"
    )
    return Rejection(Reason.STALE, text)


def check_contact(touch: Touch | None, nominal: NominalContact, size: tuple[int, int]) -> Rejection | None:
    """No contact, off position, or None. size: (width, height) of the picture, for the sentence in its pixels."""
    if touch is None or touch.area == 0:
        text = Sentence("nothing touches the gel where the part should be; check the part and grip")
        return Rejection(Reason.NO_CONTACT, text)
    for (low, high), place, side, what, unit in (
        (nominal.x, touch.x, size[0], Sentence("centre column"), " px"),
        (nominal.y, touch.y, size[1], Sentence("centre row"), " px"),
        (nominal.area, touch.area, 1, Sentence("area in the view"), ""),
    ):
        if not low * side <= place * side <= high * side:
            text = Sentence(
                f"the contact's {what} is {place * side:.3g}{unit}, nominal presses have {low * side:.3g} to "
                f"{high * side:.3g}{unit}; check how the part meets the sensor"
            )
            return Rejection(Reason.OFF_POSITION, text)
    return None
