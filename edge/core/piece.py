"""A piece that is pressed at several places: which of them are still to be pressed, and one verdict when all came.

A place is filled by a press that passes or fails, once: a fail is not pressed away, and a pass is not pressed again. A
press that is unsure, rejected or in error leaves it open, so that it must be pressed again.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from edge.core.errors import ConfigError
from edge.core.part_position import PartPosition

__all__ = ["End", "Filled", "Order", "Piece", "PieceVerdict", "PlacePress", "check_places"]

Order = Literal["free", "fixed"]
PieceVerdict = Literal["pass", "fail", "incomplete"]
End = Literal["complete", "time", "next piece"]
"""Why a piece is over: every place came, it took too long, or another one was begun."""


@dataclass(frozen=True)
class Filled:
    """A place with the press that decided it."""

    place: PartPosition
    press_id: str
    verdict: Literal["pass", "fail"]


@dataclass(frozen=True)
class Piece:
    """One piece, and what was pressed of it."""

    piece_id: str
    began_ns: int
    """Wall clock."""
    places: tuple[PartPosition, ...]
    """Every place of the plan, each once."""
    order: Order
    filled: tuple[Filled, ...] = ()
    """In the order in which they were pressed."""

    @property
    def missing(self) -> tuple[PartPosition, ...]:
        """The places that are still to be pressed."""
        done = {place.place for place in self.filled}
        return tuple(place for place in self.places if place not in done)

    @property
    def expected(self) -> tuple[PartPosition, ...]:
        """The places that may be pressed next."""
        return self.missing[:1] if self.order == "fixed" else self.missing

    @property
    def has_failed(self) -> bool:
        return any(place.verdict == "fail" for place in self.filled)

    @property
    def verdict(self) -> PieceVerdict:
        """Its verdict if it ended now: a pass only where every place has passed."""
        if self.has_failed:
            return "fail"
        return "incomplete" if self.missing else "pass"

    def take(self, place: PartPosition, press_id: str, word: str) -> "Piece":
        """Return it after a press: the place is filled where it is expected, and the press has passed or failed."""
        if place not in self.expected or word not in ("pass", "fail"):
            return self
        verdict: Literal["pass", "fail"] = "pass" if word == "pass" else "fail"
        return replace(self, filled=(*self.filled, Filled(place, press_id, verdict)))


@dataclass(frozen=True)
class PlacePress:
    """What a press means for its piece, known before its score."""

    piece_id: str
    place: PartPosition | None
    """The place that it is of; None where the piece is not to be pressed there now."""
    begins: bool
    """The piece begins with it, by its first judged press or by its code."""
    has_failed: bool
    """Another place of the piece has failed."""
    is_last: bool
    """No other place is missing."""

    def show(self, word: str) -> str | None:
        """Return what an output may show of this press: a pass only where the whole piece passes, a fail for every
        further press of a piece that has failed; None for a place that passes while others are missing."""
        if word != "pass" or (self.is_last and not self.has_failed):
            return word
        return "fail" if self.has_failed else None


def check_places(places: Sequence[PartPosition], find_all: Callable[[str], Collection[PartPosition]]) -> None:
    """Check that each place has a bundle. find_all: the positions of a name. Errors: ConfigError."""
    lacking = [str(place) for place in places if place not in find_all(str(place))]
    if lacking:
        raise ConfigError(
            f"piece.places: this station has no bundle for {', '.join(lacking)}; add one to [inspection], or take the "
            "place out of the plan"
        )
