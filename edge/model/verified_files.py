"""Files of a bundle whose bytes have the SHA-256 of the manifest, and pictures of the size that it says."""

import hashlib

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import BundleCorrupt
from edge.model.archive import MAX_FILE_BYTES, Archive
from edge.model.manifest import FileEntry

__all__ = ["read_picture", "read_verified", "verify"]


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
