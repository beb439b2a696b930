"""What a fit chose, and why: method, trunk, limit, the check for missing relief, rendered copies in the bank.

All are entries of the manifest's `facts`.
"""

from collections.abc import Mapping
from typing import Any, Final

__all__ = [
    "AUGMENTATION",
    "BACKBONE_CHOICE",
    "LIMIT",
    "METHOD_CHOICE",
    "MISSING",
    "UNPROVEN",
    "USUAL_CONTACT",
    "choice_sentence",
    "copies_of_each",
]

UNPROVEN = "not proven: "
"""So begins a warning of `fit` that says what the bundle's own evidence does not show. They are the first warnings."""

BACKBONE_CHOICE: Final = "backbone_choice"
"""The entry's name: `chosen`, `why`, and `found`, what banks on each trunk saw of damage, by its kind; absent where the
backbone was named."""

METHOD_CHOICE: Final = "method_choice"
"""The entry's name: `chosen`, `why`, and `found`, what banks of each method on each trunk saw of damage, by its kind;
absent where the method was named."""

AUGMENTATION: Final = "augmentation"
"""The entry's name: `each`, the rendered copies of every nominal press that the bank learnt, and `why`; else absent."""

LIMIT: Final = "limit"
"""The entry's name: `kind`, `why`, and `found`, the share of rendered damage by kind."""

MISSING: Final = "missing_relief"
"""The entry's name: `is_checked`, `why`, `found`, the share of smoother presses, and `tap`, whose features are read."""

USUAL_CONTACT = "relief_expected"
"""The array of the bank with the mean contact of nominal presses, where missing relief is checked."""


def choice_sentence(facts: Mapping[str, Any], name: str) -> str:
    """Say what the fit chose in this entry, and why; empty for a bundle without it."""
    entry = facts.get(name)
    choice = {LIMIT: "kind", MISSING: "is_checked"}.get(name, "why")
    if not isinstance(entry, Mapping) or not {choice, "why"} <= entry.keys():
        return ""
    if name == LIMIT:
        return f"{entry[choice]}: {entry['why']}"
    if name == MISSING:
        return f"{'checked' if entry[choice] else 'not checked'}: {entry['why']}"
    return str(entry["why"])


def copies_of_each(facts: Mapping[str, Any]) -> int:
    """Return the copies of every nominal press in the bundle's bank, 0 for none."""
    entry = facts.get(AUGMENTATION)
    return int(entry.get("each", 0)) if isinstance(entry, Mapping) else 0
