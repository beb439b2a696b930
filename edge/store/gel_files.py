"""What is known of each gel, in files: the first picture of the free gel, to measure wear, the last, scars, charts.

They are no records: a damaged or missing one is learnt again, and no count depends on them.
"""

import io
import logging
import os
import tokenize
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import Reference
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["KEPT_GELS", "GelFiles"]

log = logging.getLogger(__name__)

T = TypeVar("T")
Name = Literal["first", "last", "scars", "drift"]

# Gels of one sensor whose files are kept, the newest ones; 1.5 MB each.
KEPT_GELS: Final = 20

# Of a damaged file: EOFError of an empty one; from MemoryError on, of a header, which numpy parses as Python text.
_DAMAGED: Final = (
    OSError,
    EOFError,
    ValueError,
    MemoryError,
    RecursionError,
    TypeError,
    LookupError,
    SyntaxError,
    tokenize.TokenError,
)


class GelFiles:
    """A folder of `<serial>/<gel id>.<name>.npy`. A file that cannot be read or written is logged, and never raises."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def load_picture(self, serial: str, gel_id: str, name: Literal["first", "last"]) -> Reference | None:
        """Read a picture of the free gel, float32 (h, w, 3), RGB; None when it is missing or cannot be read."""
        return self.load(serial, gel_id, name, _reference)

    def save_picture(
        self, serial: str, gel_id: str, reference: Reference, *, is_confirmed: bool = True
    ) -> None:
        """Keep this picture as the last of its gel, and as the first if it has none. is_confirmed: it is known to be of
        the free gel; otherwise it may be the first one, and no start compares with it."""
        is_kept = not is_confirmed or self.save(serial, gel_id, "last", reference.view)
        if is_kept and not self._path(serial, gel_id, "first").exists():
            self.save(serial, gel_id, "first", reference.view)
            self._remove_old(serial)

    def has_others(self, serial: str, gel_id: str) -> bool:
        """Tell whether another gel was on this sensor before, as far as its files are still there."""
        own = self._path(serial, gel_id, "first")
        return any(path != own for path in own.parent.glob("*.first.npy"))

    def forget(self, serial: str, gel_id: str, *names: Name) -> None:
        """Remove what proved to be wrong of this gel; it is learnt again."""
        for path in (self._path(serial, gel_id, name) for name in names):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                log.warning("%s was not removed: %s", path, error.strerror or error)

    def load(self, serial: str, gel_id: str, name: Name, make: Callable[[NDArray[Any]], T]) -> T | None:
        """Read a file of a gel; None when it is missing or cannot be read. make: makes the value of the array, and
        raises ValueError for one that is none."""
        path = self._path(serial, gel_id, name)
        try:
            return make(_read_array(path.read_bytes()))
        except FileNotFoundError:
            return None
        except _DAMAGED as error:
            log.warning("%s of a gel cannot be used and is learnt again: %s", path, error)
            return None

    def save(self, serial: str, gel_id: str, name: Name, array: NDArray[Any]) -> bool:
        """Write the file, complete or not at all; returns whether it was written."""
        path = self._path(serial, gel_id, name)
        part = path.with_suffix(".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = io.BytesIO()
            np.save(content, array, allow_pickle=False)
            part.write_bytes(content.getvalue() + _checksum(content.getvalue()))
            os.replace(part, path)
        except OSError as error:
            log.warning("%s was not kept: %s", path, error.strerror or error)
            return False
        return True

    def _remove_old(self, serial: str) -> None:
        """Remove the files of gels that were replaced long ago: nothing is compared with them any more."""
        folder, end = self.folder / _file_name(serial), ".last.npy"
        try:
            lasts = sorted(folder.glob(f"*{end}"), key=lambda path: path.stat().st_mtime_ns)
            for last in lasts[:-KEPT_GELS]:
                for other in (end, ".first.npy", ".scars.npy", ".drift.npy"):
                    last.with_name(last.name.replace(end, other)).unlink(missing_ok=True)
        except OSError as error:
            log.warning("old files in %s were not removed: %s", folder, error.strerror or error)

    def _path(self, serial: str, gel_id: str, name: Name) -> Path:
        return self.folder / _file_name(serial) / f"{_file_name(gel_id)}.{name}.npy"


def _checksum(content: bytes) -> bytes:
    """Make what follows the array in its file: without it, a file that a power cut has torn could be read as another
    array."""
    return b"%08x" % zlib.crc32(content)


def _read_array(data: bytes) -> NDArray[Any]:
    """Read a file; that of an earlier version has no checksum. Errors: EOFError, ValueError."""
    stream = io.BytesIO(data)
    array = np.load(stream, allow_pickle=False)
    end = stream.tell()
    if data[end:] not in (b"", _checksum(data[:end])):
        raise ValueError("its checksum is another one; a power cut may have torn it")
    return np.asarray(array)


def _reference(view: NDArray[Any]) -> Reference:
    if view.shape != (*reversed(VIEW_SIZE), 3):
        raise ValueError(f"it is {view.shape}")
    return Reference(view)


def _file_name(text: str) -> str:
    """Make a file name of any id: a character that is not a letter, a digit, `-` or `_` is replaced by its code."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else f"%{ord(c):x}" for c in text)
