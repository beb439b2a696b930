"""The revision of a bundle: a number that rises with every fit of one position of one part.

A signature says who made a bundle, not that it is the newest: an older one of the same maker, with a fault that was
corrected since, stays signed. The revision finds it.
"""

from edge.core.errors import BundleMismatch
from edge.model.manifest import Manifest

__all__ = ["check_revision"]


def check_revision(manifest: Manifest, newest: int | None, where: str) -> None:
    """newest: revision of the newest bundle in use here, None where none had one. Errors: BundleMismatch."""
    revision = manifest.revision
    if newest is None or (revision is not None and revision >= newest):
        return
    has = "no revision" if revision is None else f"revision {revision}"
    raise BundleMismatch(
        f"bundle {where} for {manifest.part}/{manifest.position} has {has}, and revision {newest} was in use here: it "
        'is older; use the newer one, or set inspection.older = "allowed" to go back on purpose'
    )
