"""Files of a bundle whose bytes have the SHA-256 of the manifest, pictures of the size that it says, and its trunk.

The trunk is in the bundle, in a folder of trunks, or among the installed backbones.
"""

import hashlib
from collections.abc import Container, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge import registry
from edge.core.errors import BundleCorrupt, GelgateError
from edge.model.archive import MAX_FILE_BYTES, Archive, open_archive
from edge.model.graph_cut import cut_trunk
from edge.model.manifest import BackboneEntry, FileEntry, Manifest
from edge.model.onnx_validation import GraphRefused

__all__ = ["read_picture", "read_trunk", "read_verified", "verify"]


def read_verified(archive: Archive, entry: FileEntry) -> bytes:
    """The bytes of that file. Errors: BundleCorrupt: missing, too large, or not the bytes that the manifest names."""
    return verify(archive.read(entry.file, min(entry.size_bytes, MAX_FILE_BYTES)), entry, archive.where)


def verify(data: bytes, entry: FileEntry, where: str) -> bytes:
    """Return the bytes when they are those that the manifest names. Errors: BundleCorrupt."""
    digest = hashlib.sha256(data).hexdigest()
    if digest != entry.sha256:
        raise BundleCorrupt(
            f"bundle {where}: {entry.file} has SHA-256 {digest[:12]} ({len(data)} bytes), the manifest expects "
            f"{entry.sha256[:12]} ({entry.size_bytes} bytes); copy the complete bundle again"
        )
    return data


def read_picture(archive: Archive, entry: FileEntry, frame: tuple[int, int]) -> NDArray[np.uint8]:
    """A picture of the region, uint8 (h, w, 3) RGB."""
    data = np.frombuffer(read_verified(archive, entry), np.uint8)
    h, w = _png_size(data.tobytes()[:24])
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR) if (h, w) == frame else None
    if bgr is None or bgr.dtype != np.uint8 or bgr.shape != (*frame, 3):
        raise BundleCorrupt(
            f"bundle {archive.where}: the picture {entry.file} is {h}x{w}, expected a PNG of {frame[0]}x{frame[1]} (h, "
            "w) in colour; export the bundle again"
        )
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


def _png_size(head: bytes) -> tuple[int, int]:
    """(h, w) from the first 24 bytes of a PNG, (0, 0) of something else: a small file can hold a gigantic picture."""
    if not head.startswith(b"\x89PNG\r\n\x1a\n") or len(head) < 24:
        return 0, 0
    return int.from_bytes(head[20:24], "big"), int.from_bytes(head[16:20], "big")


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
