"""Requests to a running station, from any thread: trigger, relearn, replace_gel."""

import json
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.clock import ManualClock, SystemClock
from edge.core.errors import GelgateError
from edge.gateway.command_table import every_command, station_handlers
from edge.gateway.loop_calls import LoopCalls
from edge.messaging.command_payloads import ReplaceGelArguments
from edge.store.outbox import Outbox


def answer(ask: Callable[[], object], turn: Callable[[], object]) -> str:
    """Ask on a thread of its own, while the loop has its turns; return the refusal's sentence, empty on success."""
    answers: list[str] = []

    def run() -> None:
        try:
            ask()
        except (GelgateError, ValueError) as error:
            answers.append(str(error))

    asker = threading.Thread(target=run)
    asker.start()
    while asker.is_alive():
        turn()
    return "".join(answers)


def test_a_triggered_press_has_one_verdict_and_a_new_gel_starts_at_0(tmp_path: Path, bundle: Path) -> None:
    """No press, no verdict; one press, one verdict, for any number of requests; then the gel is replaced."""
    recording = press_recording(tmp_path / "presses", 2, motion=Motion(hold=24, idle=10), seed=4)
    with SteppedStation(
        station_config(tmp_path / "station", recording, bundle, trigger="command")
    ) as station:
        handlers = station_handlers(station.parts.calls, every_command())

        def ask(verb: str, **arguments: object) -> str:
            return answer(lambda: handlers[verb](arguments), station.turn)

        station.play_until(lambda: station.loop.session is not None)
        answers = [ask("trigger")]
        while not station.reports:
            station.play(1)
            answers.append(ask("trigger"))
        station.play(1)
        assert ask("trigger").startswith("this press has its verdict")
        assert ask("replace_gel", gel_id="next", limit_presses=7) == ""
        assert ask("replace_gel", gel_id="next").startswith("gel 'next' was already used")
        with Outbox(station.parts.store.path) as outbox:
            waiting = {row.message.topic: row.message.payload for row in outbox.pending("none", 100)}
        assert json.loads(waiting["gel"])["gel_id"] == "next", (
            "the old gel's count waits, and comes after the new gel"
        )

    assert answers[0].startswith("nothing presses the gel")
    assert "" in answers
    assert station.verdicts == ["pass"]
    assert (station.loop.session.gel.gel_id, station.loop.session.gel.limit_presses) == ("next", 7)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"gel_id": ["x"]}, "gel_id: Input should be a valid string"),
        ({"limit_presses": 10**30}, "limit_presses: Input should be less than or equal to"),
        ({"limit_presses": True}, "limit_presses: Input should be a valid integer"),
        (
            {"serial": "x"},
            "serial: Extra inputs .* \\(known arguments: gel_id, limit_presses, note, gel_serial",
        ),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ReplaceGelArguments.of(arguments)


def test_a_call_is_done_by_the_thread_that_serves_and_answered_to_the_asker() -> None:
    """Its fault too, which does not end the loop."""
    calls, done = LoopCalls[str](SystemClock()), list[object]()

    def do(name: str) -> None:
        done.append((name, threading.get_ident()))
        raise ValueError("no such gel")

    assert answer(lambda: calls.ask(do), lambda: calls.serve("loop")) == "no such gel"
    assert done == [("loop", threading.get_ident())]


def test_calls_and_frames_are_taken_in_the_order_of_their_times() -> None:
    """A frame that came before a call, or with it, is looked at before it, however the call was made."""
    clock, done = ManualClock(), list[str]()
    calls = LoopCalls[str](clock)
    calls.post(lambda frame: done.append(f"post {frame}"))

    def look() -> None:
        calls.serve("before", clock.monotonic_ns())
        calls.serve("after", clock.monotonic_ns() + 1)

    answer(lambda: calls.ask(lambda frame: done.append(f"ask {frame}")), look)
    assert done == ["post after", "ask after"]


def test_a_call_that_was_refused_is_not_done_later() -> None:
    """It was not answered in time, or the loop has ended; one that was posted is done once."""
    calls, done = LoopCalls[str](SystemClock(), answer_s=0.01), list[str]()
    with pytest.raises(GelgateError, match=r"did not answer within 0\.01 s, and has not done it"):
        calls.ask(done.append)
    calls.post(done.append)
    calls.serve("first")
    calls.serve("second")
    calls.close("end")
    calls.post(done.append)
    calls.serve("after")

    assert done == ["first"]
    with pytest.raises(GelgateError, match="the station is ending"):
        calls.ask(done.append)
