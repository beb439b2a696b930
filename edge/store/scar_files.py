"""What is known of a gel's scars, in files next to the pictures of the free gel.

They are no records: a damaged or missing one is learnt again from the next presses.
"""

import logging
import os
from pathlib import Path

import numpy as np

from edge.core.gel_scars.record import PLANES, ScarRecord
from edge.core.imaging.decode import VIEW_SIZE
from edge.store.reference_files import as_name

__all__ = ["ScarFolder"]

log = logging.getLogger(__name__)


class ScarFolder:
    """A folder of `<serial>/<gel id>.scars.npy`: float32 (7, 120, 160), 540 kB each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def load(self, serial: str, gel_id: str) -> ScarRecord | None:
        """The record; None when it is missing or cannot be read."""
        path = self._path(serial, gel_id)
        try:
            record = ScarRecord(np.load(path, allow_pickle=False)[:PLANES])
            if record.planes.shape[1:] != (VIEW_SIZE[1], VIEW_SIZE[0]):
                raise ValueError(f"it is {record.planes.shape}")
        except FileNotFoundError:
            return None
        except (OSError, EOFError, ValueError) as error:  # EOFError: an empty file after a power cut
            log.warning(
                "the scars of gel %s in %s cannot be used and are learnt again: %s", gel_id, path, error
            )
            return None
        return record

    def save(self, serial: str, gel_id: str, record: ScarRecord) -> None:
        """Keep it, complete or not at all. Never raises."""
        path = self._path(serial, gel_id)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part")
            with part.open("wb") as file:
                np.save(file, record.planes, allow_pickle=False)
            os.replace(part, path)
        except OSError as error:
            log.warning("the scars of gel %s were not kept: %s", gel_id, error.strerror or error)

    def forget(self, serial: str, gel_id: str) -> None:
        """They are learnt again."""
        try:
            self._path(serial, gel_id).unlink(missing_ok=True)
        except OSError as error:
            log.warning("the scars of gel %s were not removed: %s", gel_id, error.strerror or error)

    def _path(self, serial: str, gel_id: str) -> Path:
        return self._folder / as_name(serial) / f"{as_name(gel_id)}.scars.npy"
