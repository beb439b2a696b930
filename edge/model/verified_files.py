"""Files of a bundle whose bytes have the SHA-256 of the manifest."""

import hashlib

from edge.core.errors import BundleCorrupt
from edge.model.archive import MAX_FILE_BYTES, Archive
from edge.model.manifest import FileEntry

__all__ = ["read_verified", "verify"]


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
