"""What a check of the database says about one part of it."""

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One sentence about one part: file, presses, gels, counts, outbox or ledger."""

    part: str
    text: str
    is_fault: bool = True
