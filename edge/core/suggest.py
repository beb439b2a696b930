"""Suggestions for an unknown name."""

import difflib
from collections.abc import Iterable

__all__ = ["suggestion"]

_LISTED = 20


def suggestion(name: str, known: Iterable[str]) -> str:
    """`did you mean 'x'?` where a known name is similar, else `known: x, y`, the first 20 of them."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"known: {', '.join(names[:_LISTED]) or 'none'}{more}"
