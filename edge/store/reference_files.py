"""No-contact references, in files: the first of each gel, to measure wear, and the last, to start from.

They are not records: a damaged or missing one is learnt again, and no count depends on them.
"""

import logging
import os
from pathlib import Path
from typing import Final, Literal

import numpy as np

from edge.core.contact.reference import Reference
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["KEPT_GELS", "ReferenceFolder", "as_name"]

log = logging.getLogger(__name__)

Which = Literal["first", "last"]


# Gels of one sensor whose pictures are kept, the newest ones; 460 kB each.
KEPT_GELS: Final = 20


class ReferenceFolder:
    """A folder of `<serial>/<gel id>.<first|last>.npy`: float32 (h, w, 3), RGB."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def load(self, serial: str, gel_id: str, which: Which) -> Reference | None:
        """The picture; None when it is missing or cannot be read."""
        path = self._path(serial, gel_id, which)
        try:
            view = np.load(path, allow_pickle=False)
            if view.shape != (*reversed(VIEW_SIZE), 3):
                raise ValueError(f"it is {view.shape}")
            return Reference(view, frames=1, learnt_ns=0)
        except FileNotFoundError:
            return None
        except (OSError, EOFError, ValueError) as error:  # EOFError: an empty file after a power cut
            log.warning("the no-contact reference %s cannot be used and is learnt again: %s", path, error)
            return None

    def save(self, serial: str, gel_id: str, reference: Reference) -> None:
        """Keep this picture as the last of its gel, and as the first if it has none."""
        try:
            self._write(self._path(serial, gel_id, "last"), reference)
            first = self._path(serial, gel_id, "first")
            if not first.exists():
                self._write(first, reference)
                self._remove_old(serial)
        except OSError as error:
            log.warning(
                "the no-contact reference of gel %s was not kept: %s", gel_id, error.strerror or error
            )

    def forget(self, serial: str, gel_id: str) -> None:
        """Forget the pictures of this gel, which proved to show no free gel; they are learnt again."""
        for which in ("first", "last"):
            try:
                self._path(serial, gel_id, which).unlink(missing_ok=True)
            except OSError as error:
                log.warning(
                    "a wrong free-gel picture of %s was not removed: %s", gel_id, error.strerror or error
                )

    def _path(self, serial: str, gel_id: str, which: Which) -> Path:
        return self.folder / as_name(serial) / f"{as_name(gel_id)}.{which}.npy"

    def _remove_old(self, serial: str) -> None:
        """Remove the pictures of gels that were replaced long ago: nothing is compared with them any more."""
        lasts = sorted(
            (self.folder / as_name(serial)).glob("*.last.npy"), key=lambda path: path.stat().st_mtime_ns
        )
        for last in lasts[:-KEPT_GELS]:
            last.unlink(missing_ok=True)
            for other in (".first.npy", ".scars.npy"):
                last.with_name(last.name.replace(".last.npy", other)).unlink(missing_ok=True)

    def _write(self, path: Path, reference: Reference) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            np.save(file, reference.view, allow_pickle=False)
        os.replace(part, path)


def as_name(text: str) -> str:
    """A file name for any id: a character that is not a letter, a digit, `-` or `_` is replaced by its code."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else f"%{ord(c):x}" for c in text)
