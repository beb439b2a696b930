"""One press to record, and the words of its verdict."""

from dataclasses import dataclass
from typing import Final

from edge.store.ulid import is_ulid

__all__ = ["VERDICTS", "PressRecord"]

VERDICTS: Final = ("pass", "fail", "unsure", "rejected", "error")


@dataclass(frozen=True)
class PressRecord:
    """One press to record."""

    press_id: str
    """A ULID."""
    time_ns: int
    """Wall clock."""
    serial: str
    """The sensor's."""
    part: str
    verdict: str
    """Pass, fail, unsure, rejected, or error for a press that could not be scored."""
    position: str | None = None
    score: float | None = None
    threshold: float | None = None
    wear_index: float | None = None
    """Optical wear just before this press; None if not measured."""
    cause: str | None = None
    """The cause of a fail or unsure, where it is known: part, gel or unsure."""
    evidence: bytes | None = None
    """SHA-256 of its record in the archive; None where it has none."""
    second_of: str | None = None
    """Id of the first press of the same piece, where this one was asked for."""

    def __post_init__(self) -> None:
        if not is_ulid(self.press_id):
            raise ValueError(f"a press id is a ULID, found {self.press_id!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(f"a recorded verdict is one of {', '.join(VERDICTS)}, found {self.verdict!r}")
        if not self.serial or not self.part:
            raise ValueError(f"a press has a sensor and a part, found {self.serial!r} and {self.part!r}")
