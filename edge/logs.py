"""Log lines: as text for a terminal and journald, or as JSON for a program; with the press that they are about."""

import json
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import Final, Literal, TextIO

from edge.core.printable import write_count

__all__ = ["LineWriter", "about_press", "press_event", "start"]

LogFormat = Literal["text", "json"]

# A line that somebody reads is written within this time.
PATIENCE_S: Final = 0.25

_press_id: Final[ContextVar[str | None]] = ContextVar("press_id", default=None)


@contextmanager
def about_press(press_id: str | None) -> Iterator[None]:
    """Lines inside, of this thread, carry this press id."""
    token = _press_id.set(press_id)
    try:
        yield
    finally:
        _press_id.reset(token)


def press_event(log: logging.Logger, press_id: str, sentence: str, fields: Mapping[str, object]) -> None:
    """A line about one press, with its facts as fields of their own in JSON."""
    with about_press(press_id):
        log.info("%s", sentence, extra={"fields": dict(fields)})


def start(log_format: LogFormat, *, is_verbose: bool) -> None:
    """Log to the standard error output from now on. is_verbose: contact events and sent messages too."""
    handler = Lines(sys.stderr)
    handler.setFormatter(Json() if log_format == "json" else Text())
    logging.basicConfig(level=logging.DEBUG if is_verbose else logging.INFO, handlers=[handler])


class LineWriter:
    """Writes lines on a stream by a thread of its own: where nobody reads, as at a terminal that hangs, a write
    does not end, also where there was room for its beginning. Lines behind it are left out, and counted when they are
    read again. One thread uses it at a time.

    tell: makes the line that says how many were left out.
    """

    def __init__(self, stream: TextIO, tell: Callable[[str], str] = "{}\n".format) -> None:
        self._stream, self._tell = stream, tell
        self._lines = SimpleQueue[tuple[int, bytes]]()
        self._is_written = threading.Event()
        self._is_written.set()
        self._is_late = False
        self._left_out = 0
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None

    def put(self, line: str) -> None:
        """Write a line, or leave it out where an earlier one is not written yet. Errors: OSError."""
        if not self._is_written.wait(0 if self._is_late else PATIENCE_S):
            self._is_late, self._left_out = True, self._left_out + 1
            return
        if self._left_out:
            missed, self._left_out = write_count(self._left_out, "line"), 0
            line = self._tell(f"{missed} left out: nothing was read here; inspection went on") + line
        try:
            file = self._stream.fileno()
        except OSError:  # in memory
            self._stream.write(line)
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
            self._thread.start()
        self._is_written.clear()
        self._lines.put((file, line.encode(self._stream.encoding, self._stream.errors or "backslashreplace")))
        self._is_late = not self._is_written.wait(PATIENCE_S)
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _run(self) -> None:
        """Write past the stream: its lock, held at the end of the program, would be a crash."""
        while True:
            file, line = self._lines.get()
            try:
                while line:
                    line = line[os.write(file, line) :]
            except OSError as error:
                self._error = error
            self._is_written.set()


class Lines(logging.StreamHandler[TextIO]):
    """Log lines on a stream. No press waits for them, as at a paused terminal."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self._writer = LineWriter(stream, self._tell)

    def _tell(self, missed: str) -> str:
        record = logging.LogRecord(__name__, logging.WARNING, __file__, 0, missed, None, None)
        return self.format(record) + "\n"

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or leave it out."""
        try:
            self._writer.put(self.format(record) + "\n")
        except Exception:  # noqa: BLE001 - as every handler of logging does
            self.handleError(record)


class Text(logging.Formatter):
    """`time LEVEL part sentence`, and `[press id]` at the end of a line about one press. The time is local, with its
    offset."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s %(message)s")

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:
        return datetime.fromtimestamp(record.created, UTC).astimezone().isoformat(" ", "milliseconds")

    def formatMessage(self, record: logging.LogRecord) -> str:
        press_id = _press_id.get()
        return super().formatMessage(record) + (f" [{press_id}]" if press_id else "")


class Json(logging.Formatter):
    """One JSON object on one line: time (ISO 8601, UTC), level, logger, message; press_id, traceback and the fields of
    an event where there are any."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if press_id := _press_id.get():
            line["press_id"] = press_id
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        line |= {name: value for name, value in getattr(record, "fields", {}).items() if name not in line}
        return json.dumps(line, ensure_ascii=False, default=str)
