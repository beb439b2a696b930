"""Where the trunk of a bundle is: in the bundle, in a folder of trunks, or among the installed backbones."""

import hashlib
from collections.abc import Container, Sequence
from pathlib import Path

from edge import registry
from edge.core.errors import BundleCorrupt, GelgateError
from edge.model.archive import Archive, open_archive
from edge.model.graph_cut import cut_trunk
from edge.model.manifest import BackboneEntry, Manifest
from edge.model.onnx_validation import GraphRefused
from edge.model.verified_files import read_verified, verify

__all__ = ["read_trunk"]


def read_trunk(
    manifest: Manifest, archive: Archive, stores: Sequence[Path], loaded: Container[str]
) -> bytes | None:
    """The bytes of the trunk; None without one, and where its SHA-256 is among `loaded`.

    stores: folders of `<sha256>.onnx`, for a bundle that was sent without its trunk. Errors: BundleCorrupt.
    """
    if manifest.backbone is None or manifest.backbone.trunk.sha256 in loaded:
        return None
    entry = manifest.backbone.trunk
    if manifest.backbone.in_bundle:
        return read_verified(archive, entry)
    for store in stores:
        file = store / f"{entry.sha256}.onnx"
        if file.is_file():
            stored = entry.model_copy(update={"file": file.name})
            return verify(open_archive(store).read(file.name, entry.size_bytes), stored, archive.where)
    installed = _installed_trunk(manifest.backbone, tuple(manifest.grid.taps) if manifest.grid else ())
    if installed is not None:
        return installed
    raise BundleCorrupt(
        f"bundle {archive.where} was sent without its trunk '{manifest.backbone.id}' and {entry.sha256[:12]} is not "
        f"in {' or '.join(map(str, stores)) or 'any trunk store'}; copy it there as {entry.sha256}.onnx"
    )


def _installed_trunk(backbone: BackboneEntry, taps: tuple[str, ...]) -> bytes | None:
    """The trunk of an installed backbone of that name, complete or cut after these taps, if the hash is the same."""
    if backbone.id not in registry.names("backbones"):
        return None
    try:
        complete = registry.backbone(backbone.id).trunk()
        candidates = (complete, cut_trunk(complete, taps))
    except (GelgateError, GraphRefused, ImportError):
        return None
    wanted = backbone.trunk.sha256
    return next((trunk for trunk in candidates if hashlib.sha256(trunk).hexdigest() == wanted), None)
