"""One process per sensor: an advisory lock on a file named after it, held as long as the sensor is open.

The kernel refuses a second process on a USB interface, but not on a V4L2 node, and says only "busy". This lock covers
every stream path, names the process, and ends with the process in every case.
"""

import fcntl
import os
import re
import tempfile
from pathlib import Path

from edge.core.errors import DeviceBusy

__all__ = ["SensorLock", "lock_folder"]


def lock_folder() -> Path:
    """/run/lock where it is usable (shared by services and users alike), else the temporary folder."""
    shared = Path("/run/lock")
    return shared if os.access(shared, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


class SensorLock:
    """Held until closed. Errors: DeviceBusy with the process that holds it."""

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.path = (folder or lock_folder()) / f"gelgate-{re.sub(r'[^A-Za-z0-9_-]', '_', name)}.lock"
        self._file = _open(self.path)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(self._file, 20, 0).decode("ascii", "replace").strip() or "unknown"
            self.close()
            raise DeviceBusy(
                f"sensor {name} is in use by process {holder} (lock {self.path}); stop it, or choose another sensor"
            ) from error
        self._sign()

    def _sign(self) -> None:
        try:
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)
        except OSError:
            pass  # read-only: another user's file; the lock works, only the name of its holder is missing

    def close(self) -> None:
        """Release; harmless when repeated. The file stays: removing it would let two processes hold two files."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _open(path: Path) -> int:
    flags = os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o666)
    except PermissionError:
        return os.open(path, os.O_RDONLY | flags)  # made by another user: flock needs no write permission
