"""Log lines as text and as JSON, with the press that they are about."""

import io
import json
import logging
import re
import sys
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
    written = io.StringIO()
    handler = Lines(written)
    handler.setFormatter(Json())
    for is_read in (True, False, False, True, True):
        monkeypatch.setattr("edge.logs.is_read", lambda _, is_read=is_read: is_read)
        handler.handle(record())

    assert [json.loads(line)["message"] for line in written.getvalue().splitlines()] == [
        "the sensor is gone",
        "2 lines left out: nothing was read here; inspection went on",
        "the sensor is gone",
        "the sensor is gone",
    ]
