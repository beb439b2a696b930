"""The pictures of a bundle: PNG files of a known size, checked before they are decoded."""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import BundleCorrupt
from edge.model.archive import Archive
from edge.model.manifest import FileEntry
from edge.model.verified_files import read_verified

__all__ = ["png_bytes", "read_picture"]


def png_bytes(rgb: NDArray[np.uint8]) -> bytes:
    """uint8 (h, w, 3) RGB as a PNG file."""
    return bytes(cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1])


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
