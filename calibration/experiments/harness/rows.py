"""Results as rows in a file of JSON lines: one line per finished cell, so that an interrupted study continues."""

import contextlib
import errno
import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge.core.errors import ConfigError, StoreError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["ROWS_FILE", "ROW_FORMAT", "TIMES", "Rows", "frame", "read_rows", "rows_of_studies"]

ROWS_FILE = "rows.jsonl"

ROW_FORMAT = 1
"""Written in every row; a file of another format is refused, because its columns mean something else."""


TIMES = ("cpu_fit_s", "cpu_score_s", "cpu_measure_s")
"""The columns with the processor seconds of a cell; their sum is what it took."""


class Rows:
    """A file of rows that grows by complete lines.

    path: the file, made with its folder when the first row comes. say: called with a sentence about a line that was
    dropped. Errors: ConfigError for a file that holds something else, or rows of another format.
    """

    def __init__(self, path: Path, say: Callable[[str], None] = lambda sentence: None) -> None:
        self.path = path
        self._say = say
        self._keys = {str(row["key"]) for row in self.read()}

    def done(self) -> set[str]:
        """The keys of the cells that have a row."""
        return set(self._keys)

    def read(self) -> list[dict[str, Any]]:
        """All rows, in the order in which they were written."""
        return read_rows(self.path, self._say)

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        """Within it no other process adds rows to the file. Errors: ConfigError if one does already."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigError(
                    f"another study is writing rows to '{self.path}'; wait for its end, or choose another folder"
                ) from None
            self._keys = {str(row["key"]) for row in self.read()}
            yield

    def append(self, row: Mapping[str, Any]) -> None:
        """Write one row; complete, or not at all.

        Errors: StoreError where the disk refuses, with the number of rows that are kept; ValueError without a key, or
        for a number that is not finite.
        """
        line = json.dumps({"format": ROW_FORMAT, **row}, allow_nan=False).encode() + b"\n"
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab", buffering=0) as file:
            before = _drop_torn(file, self.path)
            try:
                _write_all(file, line)
                os.fsync(file.fileno())
            except OSError as error:
                with contextlib.suppress(OSError):
                    file.truncate(before)
                raise StoreError(self._say_refusal(error)) from error
        self._keys.add(str(row["key"]))

    def _say_refusal(self, error: OSError) -> str:
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        why = "the disk is full" if is_full else f"the disk refuses ({error.strerror})"
        return (
            f"{why}: the {len(self._keys)} rows so far are kept in '{self.path}'; "
            f"{'free some space' if is_full else 'see to the disk'} and give the same command again to continue"
        )


def _write_all(file: FileIO, line: bytes) -> None:
    """Unbuffered, so that nothing is left to be written when the file is closed. Errors: OSError."""
    rest = memoryview(line)
    while rest:
        rest = rest[file.write(rest) :]


def _drop_torn(file: FileIO, path: Path) -> int:
    """The length of the complete lines; what follows them, a line that an interrupted run began, is cut off."""
    size = file.tell()
    with path.open("rb") as content:
        content.seek(max(0, size - 1))
        if not size or content.read(1) == b"\n":
            return size
        content.seek(0)
        complete = content.read().rfind(b"\n") + 1
    file.truncate(complete)
    return complete


def read_rows(path: Path, say: Callable[[str], None] = lambda sentence: None) -> list[dict[str, Any]]:
    """The rows of a file, none if it does not exist. A last line without an end is left out, with a sentence.

    Errors: ConfigError for a line that is no row of this format.
    """
    if not path.is_file():
        return []
    lines = path.read_bytes().split(b"\n")
    if lines[-1]:
        say(f"the last line of '{path}' is incomplete, because a run was interrupted; its cell is done again")
    return [_row(line, number, path) for number, line in enumerate(lines[:-1], start=1)]


def rows_of_studies(path: Path, say: Callable[[str], None] = lambda sentence: None) -> list[dict[str, Any]]:
    """The rows of a file, or of the one in a folder. Errors: ConfigError where there is no row, or none of a study."""
    file = path / ROWS_FILE if path.is_dir() else path
    way_on = "name the rows.jsonl that `gelgate lab study` wrote"
    if not file.is_file():
        raise ConfigError(f"there are no rows at '{file}'; {way_on}")
    rows = read_rows(file, say)
    if not rows:
        raise ConfigError(f"'{file}' has no complete row yet; continue the study")
    if any("study" not in row for row in rows):
        raise ConfigError(f"'{file}' has rows that are of no study; {way_on}")
    return rows


def _row(line: bytes, number: int, path: Path) -> dict[str, Any]:
    try:
        row = json.loads(line, parse_constant=_not_finite)
        row_format, _ = row["format"], row["key"]
    except (ValueError, KeyError, TypeError):
        raise ConfigError(
            f"line {number} of '{path}' is not a row of results; name the rows.jsonl that `gelgate lab study` or "
            "`gelgate lab tradeoff` wrote"
        ) from None
    if row_format != ROW_FORMAT:
        raise ConfigError(
            f"'{path}' has rows of format {row_format!r}, this program reads format {ROW_FORMAT}; "
            "choose another folder, or use the program that wrote them"
        )
    return dict(row)


def _not_finite(name: str) -> float:
    """A row has null where a measure is undefined. Errors: ValueError."""
    raise ValueError(name)


def frame(path: Path) -> "pd.DataFrame":
    """The rows of a file as a pandas frame. Errors: ConfigError as `read_rows`."""
    import pandas as pd

    return pd.DataFrame(read_rows(path))
