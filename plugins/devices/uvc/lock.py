"""One process per sensor: an advisory lock on a file named after it, held as long as the sensor is open.

The kernel refuses a second process on a USB interface, but not on a V4L2 node, and says only "busy". This lock covers
every stream path, names the process, and ends with the process in every case.
"""

import fcntl
import os
import re
import tempfile
from contextlib import suppress
from pathlib import Path

from edge.core.errors import DeviceBusy

__all__ = ["SensorLock"]

# Shared by services and users alike; where it is not usable, the temporary folder is.
_SHARED = Path("/run/lock")


class SensorLock:
    """Held until closed. Errors: DeviceBusy with the process that holds it, or with why its file cannot be opened."""

    def __init__(self, name: str, folder: Path | None = None) -> None:
        if folder is None:
            folder = _SHARED if os.access(_SHARED, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
        self.path = folder / f"gelgate-{re.sub(r'[^A-Za-z0-9_-]', '_', name)}.lock"
        try:
            self._file = _open(self.path)
        except OSError as error:
            raise DeviceBusy(
                f"sensor {name}: its lock {self.path} cannot be opened ({error.strerror}), so it may be in use; remove "
                "it if no other program holds the sensor"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(self._file, 20, 0).decode("ascii", "replace").strip() or "unknown"
            self.close()
            raise DeviceBusy(
                f"sensor {name} is in use by process {holder} (lock {self.path}); stop it, or choose another sensor"
            ) from error
        with suppress(OSError):  # read-only: another user's file; only the holder's name is missing
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def close(self) -> None:
        """Release; harmless when repeated. The file stays: removing it would let two processes hold two files."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _open(path: Path) -> int:
    flags = os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o644)
    except PermissionError:
        return os.open(path, os.O_RDONLY | flags)  # made by another user: flock needs no write permission
    with suppress(OSError):  # whatever the umask, that of the service is 0027: other users need to read it
        os.fchmod(file, 0o644)
    return file
