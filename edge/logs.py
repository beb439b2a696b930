"""Log lines: as text for a terminal and journald, or as JSON for a program; with the press that they are about."""

import json
import logging
import select
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Final, Literal, TextIO

from edge.core.printable import write_count

__all__ = ["about_press", "is_read", "press_event", "start"]

LogFormat = Literal["text", "json"]

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


def is_read(stream: TextIO) -> bool:
    """Tell whether a line can be written without waiting for who reads; true also where writing fails."""
    try:
        return bool(select.select([], [stream], [], 0)[1])
    except (OSError, ValueError):
        return True


class Lines(logging.StreamHandler[TextIO]):
    """Log lines on a stream. No press waits for them: while nobody reads, as at a paused terminal, they are left out,
    and counted when they are read again."""

    _left_out = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or leave it out."""
        if not is_read(self.stream):
            self._left_out += 1
            return
        if self._left_out:
            said = (
                "%s left out: nothing was read here; inspection went on",
                write_count(self._left_out, "line"),
            )
            self._left_out = 0
            super().emit(logging.LogRecord(__name__, logging.WARNING, __file__, 0, said[0], said[1:], None))
        super().emit(record)


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
