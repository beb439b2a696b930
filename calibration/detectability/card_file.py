"""The card into a bundle: its manifest is written again, every other file stays as it is."""

from pathlib import Path

from edge.core.errors import StoreError
from edge.model.archive import MANIFEST, open_archive, write_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, manifest_bytes, parse_manifest
from edge.model.detectability import CARD, DetectabilityCard
from edge.model.signature import SIGNATURE
from edge.model.verified_files import read_verified

__all__ = ["write_card"]


def write_card(path: Path, card: DetectabilityCard) -> bool:
    """Put the card into a bundle, in place of an older one; at once or not at all.

    A signature no longer holds and is removed: True where there was one. Errors: BundleError, StoreError.
    """
    archive = open_archive(path)
    manifest = parse_manifest(archive.read(MANIFEST, MAX_MANIFEST_BYTES), archive.where)
    files = {entry.file: read_verified(archive, entry) for entry in manifest.files}
    facts = {**manifest.facts, CARD: card.model_dump(mode="json")}
    files[MANIFEST] = manifest_bytes(manifest.model_copy(update={"facts": facts}))
    was_signed = archive.has(SIGNATURE)
    try:
        write_archive(path, files, overwrite=True)
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written: {error.strerror or error}; free some space, or make it writable"
        ) from error
    return was_signed
