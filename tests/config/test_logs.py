"""Log lines as text and as JSON, with the press that they are about."""

import fcntl
import json
import logging
import os
import pty
import re
import sys
import threading
from collections.abc import Callable

import pytest

from edge.logs import Json, Lines, Text, about_press, press_event

T0 = 1_780_000_000.25


def record(sentence: str = "the sensor is gone", **fields: object) -> logging.LogRecord:
    made = logging.LogRecord("edge.gateway", logging.WARNING, __file__, 1, "%s", (sentence,), None)
    made.created = T0
    if fields:
        made.fields = fields
    return made


def test_a_json_line_is_one_object_with_time_level_and_sentence() -> None:
    """The time is UTC; letters of every language stay as they are."""
    assert json.loads(Json().format(record("Prüfling\nfehlt"))) == {
        "time": "2026-05-28T20:26:40.250+00:00",
        "level": "warning",
        "logger": "edge.gateway",
        "message": "Prüfling\nfehlt",
    }
    assert "\n" not in Json().format(record("two\nlines"))


def test_fields_of_an_event_are_fields_of_the_line() -> None:
    """And never replace what every line has."""
    line = json.loads(Json().format(record(verdict="fail", score=1.5, level="none")))

    assert (line["verdict"], line["score"], line["level"]) == ("fail", 1.5, "warning")


def test_a_traceback_is_a_field() -> None:
    """On the same line, so that a program that reads lines is not confused."""
    made = record()
    try:
        raise RuntimeError("broken")
    except RuntimeError:
        made.exc_info = sys.exc_info()

    line = json.loads(Json().format(made))
    assert line["traceback"].endswith("RuntimeError: broken")


@pytest.mark.parametrize(
    ("formatted", "has"),
    [
        (lambda made: Json().format(made), lambda line: json.loads(line).get("press_id") == "01ABC"),
        (lambda made: Text().format(made), lambda line: line.endswith(" [01ABC]")),
    ],
)
def test_a_line_about_a_press_has_its_id(
    formatted: Callable[[logging.LogRecord], str], has: Callable[[str], bool]
) -> None:
    """Inside the block alone."""
    with about_press("01ABC"):
        assert has(formatted(record()))
    assert not has(formatted(record()))


def test_a_line_for_a_person_has_local_time_with_its_offset() -> None:
    assert re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d [A-Z]+ ", Text().format(record()))


def test_a_press_is_an_event(caplog: pytest.LogCaptureFixture) -> None:
    caplog.handler.setFormatter(Json())
    with caplog.at_level(logging.INFO):
        press_event(logging.getLogger("edge"), "01ABC", "bolt passes", {"event": "press", "verdict": "pass"})

    line = json.loads(caplog.text)
    assert (line["press_id"], line["event"], line["verdict"]) == ("01ABC", "press", "pass")


def test_lines_that_nobody_reads_are_left_out_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of them waits for who reads, and no line behind it does."""
    monkeypatch.setattr("edge.logs.PATIENCE_S", 0.05)
    reading, writing = os.pipe()
    full = os.write(writing, b" " * fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096))
    with os.fdopen(writing, "w", encoding="utf-8") as stream:
        handler = Lines(stream)
        handler.setFormatter(Json())
        for number in range(3):
            handler.handle(record(f"line {number}"))
        assert os.read(reading, full) == b" " * full
        first = os.read(reading, 4096)
        assert handler._writer._is_written.wait(10)
        for number in (3, 4):
            handler.handle(record(f"line {number}"))
    later = os.read(reading, 4096)
    os.close(reading)

    assert [json.loads(line)["message"] for line in (first + later).splitlines()] == [
        "line 0",
        "2 lines left out: nothing was read here; inspection went on",
        "line 3",
        "line 4",
    ]


@pytest.mark.parametrize(("open_pair", "length"), [(pty.openpty, 333), (os.pipe, 9000)])
def test_a_line_that_fits_in_part_holds_up_nobody(
    open_pair: Callable[[], tuple[int, int]], length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal that hangs, and a long traceback: there is room for the beginning of a line, so the system says that
    one can be written, and then never ends."""
    monkeypatch.setattr("edge.logs.PATIENCE_S", 0.05)
    reading, writing = open_pair()
    with os.fdopen(writing, "w", encoding="utf-8") as stream:
        handler = Lines(stream)
        handler.setFormatter(Text())
        lines = [record("x" * length)] * 400
        logging_thread = threading.Thread(target=lambda: [handler.handle(one) for one in lines], daemon=True)
        logging_thread.start()
        logging_thread.join(20)
        assert not logging_thread.is_alive()
        assert handler._writer._left_out > 100
        os.close(reading)  # ends the write, before another file has its number
        assert handler._writer._is_written.wait(10)
