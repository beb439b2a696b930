"""When to warn of a disk that fills up, before the database is refused its writes."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

__all__ = ["FreeSpace", "free_bytes"]

# The alarm ends when there is this much more room than where it began, so that it does not come and go.
CLEARED_AT: Final = 1.1


def free_bytes(path: Path) -> int | None:
    """Room for the gateway's user on the disk of this file; None where it cannot be asked."""
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return None


class FreeSpace:
    """The room on the disk of the database. warn_bytes: less is an alarm. ask: how much there is.

    bytes: as last asked.
    """

    def __init__(
        self, database: Path, warn_bytes: int, ask: Callable[[Path], int | None] = free_bytes
    ) -> None:
        self.bytes: int | None = None
        self._database = database
        self._warn_bytes = warn_bytes
        self._ask = ask
        self._is_low = False

    def check(self) -> str | None:
        """Ask again; the sentence of the alarm, None while there is room."""
        self.bytes = self._ask(self._database)
        if self.bytes is not None:
            self._is_low = self.bytes < self._warn_bytes * (CLEARED_AT if self._is_low else 1)
        if not self._is_low or self.bytes is None:
            return None
        return (
            f"the disk of {self._database} has {self.bytes / 1e6:.0f} MB free, fewer than {self._warn_bytes / 1e6:.0f} "
            "(store.free_mb); free space before it is full: then inspection halts"
        )
