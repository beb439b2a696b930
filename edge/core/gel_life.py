"""The gel's life: what its package says of it, its presses, its limit, and what to do about it."""

import re
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from typing import Final, Self

__all__ = [
    "DEFAULT_LIMIT_PRESSES",
    "DEFAULT_WARN_FRACTION",
    "LONGEST_ID",
    "MOST_PRESSES",
    "NO_LABEL",
    "GelLabel",
    "GelState",
    "is_past",
    "state_of",
]

# The maker's figure for the GelSight Mini gel: 1,000 coin presses (datasheet). Sharp threads cut faster than coins;
# the seed paper used up two gels over 2,678 listed pictures, about 1,340 each.
DEFAULT_LIMIT_PRESSES = 1000
# A larger number is a typing error: no gel lasts as long.
MOST_PRESSES = 10_000_000
# Time to order and fit a new one.
DEFAULT_WARN_FRACTION = 0.8
# Characters of an id, a serial or a type.
LONGEST_ID: Final = 64


class GelState(StrEnum):
    """What to do about the gel. The values are part of the published payload."""

    GOOD = "good"
    DUE = "due"
    REPLACE = "replace"


@dataclass(frozen=True)
class GelLabel:
    """What the package of a gel says, as far as a person wrote it down; nothing is assumed.

    Errors: ValueError, one sentence, for what no package says.
    """

    gel_serial: str | None = None
    """The gel's own. Serials that differ in capitals only are one."""
    gel_type: str | None = None
    """Such as `plain` or `markers`; any text."""
    use_by: str | None = None
    """The last day of use, YYYY-MM-DD."""

    def __post_init__(self) -> None:
        _check_text("gel serial", self.gel_serial)
        _check_text("gel type", self.gel_type)
        if self.gel_serial is not None and not self.gel_serial.isascii():
            raise ValueError(
                f"the gel serial '{self.gel_serial}' holds a character beyond ASCII; write the Latin letters, digits "
                "and signs of its package"
            )
        if self.use_by is not None:
            _check_day(self.use_by)

    @classmethod
    def of(cls, gel_serial: str | None, gel_type: str | None, use_by: str | None) -> Self:
        """Read what was typed or scanned: blanks around it do not count."""
        return cls(*(None if text is None else text.strip() for text in (gel_serial, gel_type, use_by)))


def _check_text(what: str, text: str | None) -> None:
    if text is None:
        return
    if not text:
        raise ValueError(f"the {what} is empty; leave it out where the package names none")
    if not text.isprintable():
        raise ValueError(
            f"the {what} {text[:LONGEST_ID]!r} holds control characters; use letters, digits and signs"
        )
    if len(text) > LONGEST_ID:
        raise ValueError(
            f"the {what} '{text[:LONGEST_ID]}...' has {len(text)} characters, expected at most {LONGEST_ID}; write "
            "that of the gel alone"
        )


def _check_day(text: str) -> None:
    if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", text) is None:
        raise ValueError(
            f"the use-by date {text[:LONGEST_ID]!r} is not written as YYYY-MM-DD; write it so, such as 2027-01-31"
        )
    try:
        date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(
            f"the use-by date {text} is no day of the calendar ({error}); write that of the package"
        ) from error


NO_LABEL: Final = GelLabel()


def is_past(use_by: str | None, today: date) -> bool:
    """Tell whether the last day of use has ended."""
    return use_by is not None and today.isoformat() > use_by


def state_of(
    presses: int, limit: int = DEFAULT_LIMIT_PRESSES, warn_fraction: float = DEFAULT_WARN_FRACTION
) -> GelState:
    """Compare a gel's presses with its limit: due from the warning fraction on, replace from the limit on."""
    if presses < 0 or limit < 1:
        raise ValueError(f"presses >= 0 and limit >= 1 are needed, found {presses} and {limit}")
    if not 0 < warn_fraction <= 1:
        raise ValueError(f"the warning fraction is in (0, 1], found {warn_fraction}")
    if presses >= limit:
        return GelState.REPLACE
    return GelState.DUE if presses >= warn_fraction * limit else GelState.GOOD
