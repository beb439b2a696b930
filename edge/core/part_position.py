"""What a bundle inspects: one position of one part, and the names by which a person or a code reader selects it."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

from edge.core.suggest import suggestion

__all__ = ["PartPosition", "find_named", "find_part"]


class PartPosition(NamedTuple):
    """One position of one part, as in the manifest."""

    part: str
    position: str

    def __str__(self) -> str:
        return f"{self.part}/{self.position}"


def find_part(known: Collection[PartPosition], part: str, position: str | None) -> PartPosition:
    """The position of the part; None for a part with one position. Errors: ValueError, which names those known."""
    positions = [one for one in known if one.part == part and position in (None, one.position)]
    if len(positions) == 1:
        return positions[0]
    words = ", ".join(map(str, positions or known))
    if positions:
        raise ValueError(f"part '{part}' has several positions here ({words}); name one of them")
    asked = part if position is None else f"{part}/{position}"
    raise ValueError(f"this station has no bundle for '{asked}'; it has {words}")


def find_named(known: Collection[PartPosition], names: Mapping[str, PartPosition], name: str) -> PartPosition:
    """Find the position with this name: a configured one, `part/position`, or the part alone where it has one position.

    Errors: ValueError, which names the nearest known.
    """
    if name in names:
        return names[name]
    for position in known:
        if name == str(position):
            return position
    if any(position.part == name for position in known):
        return find_part(known, name, None)
    candidates = sorted({*names, *map(str, known)})
    raise ValueError(f"no part of this station is named '{name:.64}'; {suggestion(name, candidates)}")
