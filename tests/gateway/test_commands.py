"""Requests to a running station, from any thread: trigger, relearn, replace_gel."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import GelgateError
from edge.gateway.command_table import station_handlers
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport

Refusals = (GelgateError, ValueError)


def answered(ask: Callable[[], object]) -> str:
    """The answer's sentence, empty on success."""
    try:
        ask()
    except Refusals as error:
        return str(error)
    return ""


def test_a_triggered_press_has_one_verdict_and_a_new_gel_starts_from_nothing(
    tmp_path: Path, bundle: Path
) -> None:
    """No press, no verdict; one press, one verdict, for any number of requests; then the gel is replaced."""
    recording = press_recording(tmp_path / "presses", 2, motion=Motion(hold=24, idle=10), seed=4)
    config = load_config(
        station_config(tmp_path / "station", recording, bundle, trigger="command", loop=True)
    )
    reports: list[PressReport] = []
    answers: list[str] = []
    stop = threading.Event()

    def insist() -> None:
        deadline = time.monotonic() + 40
        while not any(report.result.verdict == "pass" for report in reports) and time.monotonic() < deadline:
            answers.append(answered(lambda: ask["trigger"]({})))
            time.sleep(0.02)
        answers.append(answered(lambda: ask["trigger"]({})))
        answers.append(answered(lambda: ask["replace_gel"]({"gel_id": "next", "limit_presses": 7})))
        answers.append(answered(lambda: ask["replace_gel"]({"gel_id": "next"})))
        stop.set()

    with Gateway.open(config, SystemClock(), reports.append) as gateway:
        ask = station_handlers(gateway.loop.calls)
        asker = threading.Thread(target=insist)
        asker.start()
        gateway.run(stop)
        asker.join()
        *asked, repeated, replaced, again = answers

    assert any(answer.startswith("nothing presses the gel") for answer in asked)
    assert "" in asked
    assert repeated.startswith("this press has its verdict")
    assert replaced == ""
    assert again.startswith("gel 'next' was already used")
    assert sum(report.result.verdict == "pass" for report in reports) == 1
    gel = gateway.loop.session.gel
    assert (gel.gel_id, gel.limit_presses) == ("next", 7)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"gel_id": ["x"]}, "gel_id: Input should be a valid string"),
        ({"limit_presses": 10**30}, "limit_presses: Input should be less than or equal to"),
        ({"limit_presses": True}, "limit_presses: Input should be a valid integer"),
        (
            {"serial": "x"},
            "serial: Extra inputs are not permitted (known arguments: gel_id, limit_presses, note)",
        ),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments: dict[str, object], words: str) -> None:
    """Each in a sentence that names the argument."""
    from edge.messaging.command_payloads import ReplaceGelArguments

    assert words in answered(lambda: ReplaceGelArguments.of(arguments))
