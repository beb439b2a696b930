"""The gel on which a bundle was made: an entry of the manifest's `facts`, absent where it was not named."""

from typing import Any, Final

from edge.core.gel_proof import MadeOn
from edge.model.manifest import Facts

__all__ = ["GEL", "gel_facts", "read_origin"]

GEL: Final = "gel"
"""The entry's name: `gel_id`, as in the gel ledger of the station."""


def read_origin(manifest: Facts) -> MadeOn:
    """Read what the bundle says of its own gel."""
    gel = manifest.facts.get(GEL)
    gel_id = gel.get("gel_id") if isinstance(gel, dict) else None
    return MadeOn(manifest.provenance.created, gel_id if isinstance(gel_id, str) else None)


def gel_facts(gel_id: str | None) -> dict[str, Any]:
    """The entry of a bundle that is made on this gel; none where the gel is not named."""
    return {} if gel_id is None else {GEL: {"gel_id": gel_id}}
