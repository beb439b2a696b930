"""What a bundle's score map is compared with, and why: an entry of the manifest's `facts`."""

from collections.abc import Mapping
from typing import Any

__all__ = ["LIMIT", "limit_sentence"]

LIMIT = "limit"
"""The entry's name among the manifest's facts: `kind`, `why`, and `found`, the share of rendered damage by kind."""


def limit_sentence(facts: Mapping[str, Any]) -> str:
    """For `fit` and `inspect`; empty for a bundle that does not say."""
    found = facts.get(LIMIT)
    if not isinstance(found, Mapping) or not {"kind", "why"} <= found.keys():
        return ""
    return f"{found['kind']}: {found['why']}"
