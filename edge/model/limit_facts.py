"""What a fit chose, and why: method, trunk, limit, the check for missing relief, rendered copies in the bank.

All are entries of the manifest's `facts`.
"""

from collections.abc import Mapping
from typing import Any

__all__ = [
    "AUGMENTATION",
    "BACKBONE_CHOICE",
    "LIMIT",
    "METHOD_CHOICE",
    "MISSING",
    "UNPROVEN",
    "USUAL_CONTACT",
    "augmentation_sentence",
    "backbone_sentence",
    "copies_of_each",
    "limit_sentence",
    "method_sentence",
    "missing_sentence",
]

UNPROVEN = "not proven: "
"""So begins a warning of `fit` that says what the bundle's own evidence does not show. They are the first warnings."""

BACKBONE_CHOICE = "backbone_choice"
"""The entry's name: `chosen`, `why`, and `found`, what banks on each trunk saw of damage, by its kind; absent where the
backbone was named."""


def backbone_sentence(facts: Mapping[str, Any]) -> str:
    """Say why this backbone was chosen; empty for a bundle that does not."""
    return _why(facts.get(BACKBONE_CHOICE))


METHOD_CHOICE = "method_choice"
"""The entry's name: `chosen`, `why`, and `found`, what banks of each method on each trunk saw of damage, by its kind;
absent where the method was named."""


def method_sentence(facts: Mapping[str, Any]) -> str:
    """Say why this method was chosen; empty for a bundle that does not."""
    return _why(facts.get(METHOD_CHOICE))


AUGMENTATION = "augmentation"
"""The entry's name: `each`, the rendered copies of every nominal press that the bank learnt, and `why`; else absent."""


def augmentation_sentence(facts: Mapping[str, Any]) -> str:
    """Say why the bank has, or lacks, rendered copies; empty for a bundle that does not."""
    return _why(facts.get(AUGMENTATION))


def copies_of_each(facts: Mapping[str, Any]) -> int:
    """The copies of every nominal press in the bundle's bank, 0 for none."""
    entry = facts.get(AUGMENTATION)
    return int(entry.get("each", 0)) if isinstance(entry, Mapping) else 0


LIMIT = "limit"
"""The entry's name among the manifest's facts: `kind`, `why`, and `found`, the share of rendered damage by kind."""


def limit_sentence(facts: Mapping[str, Any]) -> str:
    """Say which kind the limit is, and why; empty for a bundle that does not."""
    entry = facts.get(LIMIT)
    if not isinstance(entry, Mapping) or not {"kind", "why"} <= entry.keys():
        return ""
    return f"{entry['kind']}: {entry['why']}"


MISSING = "missing_relief"
"""The entry's name: `is_checked`, `why`, `found`, the share of smoother presses, and `tap`, whose features are read."""

USUAL_CONTACT = "relief_expected"
"""The array of the bank with the mean contact of nominal presses, where missing relief is checked."""


def missing_sentence(facts: Mapping[str, Any]) -> str:
    """Say whether presses are checked for missing relief, and why; empty for a bundle that does not."""
    entry = facts.get(MISSING)
    if not isinstance(entry, Mapping) or not {"is_checked", "why"} <= entry.keys():
        return ""
    return f"{'checked' if entry['is_checked'] else 'not checked'}: {entry['why']}"


def _why(choice: object) -> str:
    return str(choice.get("why", "")) if isinstance(choice, Mapping) else ""
