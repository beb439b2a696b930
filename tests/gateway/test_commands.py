"""Requests to a running station, from any thread: trigger, relearn, replace_gel."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.core.errors import GelgateError
from edge.gateway.command_table import station_handlers

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
    config = station_config(tmp_path / "station", recording, bundle, trigger="command")
    with SteppedStation(config) as station:
        handlers = station_handlers(station.parts.calls)

        def ask(verb: str, **arguments: object) -> str:
            """Of another thread, while the loop has its turns."""
            answers: list[str] = []
            asker = threading.Thread(
                target=lambda: answers.append(answered(lambda: handlers[verb](arguments)))
            )
            asker.start()
            while asker.is_alive():
                station.loop.step(None)
            return answers[0]

        station.play_until(lambda: station.loop.session is not None)
        asked = [ask("trigger")]
        while not station.reports:
            station.play(1)
            asked.append(ask("trigger"))
        station.play(1)
        repeated = ask("trigger")
        replaced = ask("replace_gel", gel_id="next", limit_presses=7)
        again = ask("replace_gel", gel_id="next")
        gel = station.loop.session.gel

    assert asked[0].startswith("nothing presses the gel")
    assert "" in asked
    assert repeated.startswith("this press has its verdict")
    assert replaced == ""
    assert again.startswith("gel 'next' was already used")
    assert [report.result.verdict for report in station.reports] == ["pass"]
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
