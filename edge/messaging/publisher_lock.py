"""The right to publish from a database: one process at a time, whatever name it uses for the file."""

import fcntl
import os
from pathlib import Path

from edge.core.errors import StoreError

__all__ = ["PublisherLock"]


class PublisherLock:
    """Held by one process at a time and lost with it. database: its file, made already.

    A symbolic link is followed, so both names have one lock. A second hard link is refused: the database's journal has
    the name of the file, so two names of one file have two journals, and SQLite would damage it.
    Ref: https://www.sqlite.org/howtocorrupt.html, 2.2.
    Errors: StoreError if another process has the lock, or the file has another name.
    """

    def __init__(self, database: Path) -> None:
        _refuse_second_name(database)
        real = database.resolve()
        path = real.with_name(real.name + ".publisher")
        try:
            self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        except OSError as error:
            raise StoreError(
                f"the lock {path} cannot be made: {error.strerror}; give the gateway's user the right"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.close()
            raise StoreError(
                f"another gelgate process publishes from database {database}; end it, or name another database"
            ) from error

    def close(self) -> None:
        """Release it. May be called again."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)


def _refuse_second_name(database: Path) -> None:
    try:
        names = database.stat().st_nlink
    except FileNotFoundError:
        return
    if names > 1:
        raise StoreError(
            f"database {database} has {names} names (hard links), and each would have its own journal; "
            "remove the others, or use a copy"
        )
