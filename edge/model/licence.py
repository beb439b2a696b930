"""The licence of a bundle's weights: stated by who brings the weights, kept in the manifest, printed by `check`."""

import re
from collections.abc import Mapping
from typing import Any

from edge.model.manifest import Manifest

__all__ = ["LICENCE", "is_non_commercial", "licence_of", "licence_sentence"]

LICENCE = "licence"
"""The key in a trunk's metadata, and in a manifest's `facts` (of a detector) or `facts.backbone` (of a trunk)."""

_NON_COMMERCIAL = re.compile(r"(?<![a-z])nc(?![a-z])|non.?commercial|research.only", re.IGNORECASE)


def licence_of(manifest: Manifest) -> str | None:
    """The licences of the bundle's weights as they were stated, None where nothing was stated."""
    backbone = manifest.facts.get("backbone")
    sources = (manifest.facts, backbone if isinstance(backbone, Mapping) else {})
    stated: list[Any] = [source.get(LICENCE) for source in sources]
    return ", ".join(dict.fromkeys(str(one) for one in stated if one)) or None


def is_non_commercial(licence: str) -> bool:
    """Tell whether a licence's name says that commercial use is not allowed, such as CC-BY-NC-4.0."""
    return _NON_COMMERCIAL.search(licence) is not None


def licence_sentence(manifest: Manifest) -> str | None:
    """The licence in words, None where nothing was stated."""
    licence = licence_of(manifest)
    if licence is None:
        return None
    limit = ": not for commercial use, not for production" if is_non_commercial(licence) else ""
    return f"licence of the weights {licence}{limit}"
