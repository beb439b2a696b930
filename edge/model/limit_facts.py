"""What a bundle's score map is compared with, and whether missing relief fails: entries of the manifest's `facts`."""

from collections.abc import Mapping
from typing import Any

__all__ = ["LIMIT", "MISSING", "limit_sentence", "missing_sentence"]

LIMIT = "limit"
"""The entry's name among the manifest's facts: `kind`, `why`, and `found`, the share of rendered damage by kind."""


def limit_sentence(facts: Mapping[str, Any]) -> str:
    """For `fit` and `inspect`; empty for a bundle that does not say."""
    found = facts.get(LIMIT)
    if not isinstance(found, Mapping) or not {"kind", "why"} <= found.keys():
        return ""
    return f"{found['kind']}: {found['why']}"


MISSING = "missing_relief"
"""The entry's name: `is_checked`, `why`, `found`, the share of smoother presses, and `tap`, whose features are read."""


def missing_sentence(facts: Mapping[str, Any]) -> str:
    """For `fit` and `inspect`; empty for a bundle that does not say."""
    found = facts.get(MISSING)
    if not isinstance(found, Mapping) or not {"is_checked", "why"} <= found.keys():
        return ""
    return f"{'checked' if found['is_checked'] else 'not checked'}: {found['why']}"
