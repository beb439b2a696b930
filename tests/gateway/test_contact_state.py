"""The contact of a running station: on its topic, at every change; and an overload, which is an alarm."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from station import station_config, variant
from stepped_station import SteppedStation

from edge.core.contact.events import PressEnded
from edge.core.contact.press_detector import GAP_S
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Message
from edge.features.contact_state import ContactWatch
from edge.features.person_verdicts import PersonVerdicts

WHOLE = ["touching", "pressing", "at_rest", "judged", "lift", "free"]


@pytest.fixture
def said(station: SteppedStation, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """All that is said on the topic, in order."""
    found: list[dict[str, Any]] = []
    announce = station.parts.publisher.announce

    def hear(message: Message) -> None:
        if message.topic == "contact":
            assert (message.qos, message.retain) == (0, True)
            found.append(json.loads(message.payload))
        announce(message)

    watch = station.find(ContactWatch)
    monkeypatch.setattr(watch, "_parts", replace(watch._parts, announce=hear))
    return found


def states(said: list[dict[str, Any]]) -> list[str]:
    """The states in order, each once."""
    names = [one["state"] for one in said]
    return [name for number, name in enumerate(names) if number == 0 or name != names[number - 1]]


def test_each_press_goes_through_all_states(station: SteppedStation, said: list[dict[str, Any]]) -> None:
    """Also where the fourth frame of a press is as deep as it gets: it is deep enough from the first one on."""
    station.play()
    assert states(said) == ["unknown", "free", *(["touching", "deep_enough", *WHOLE[2:]] * 3)]
    lifted = [one for one in said if one["state"] == "lift"]
    assert {one["press_id"] for one in lifted} == {result.press_id for result in station.results}
    assert {one["guidance"] for one in lifted} == {"lift"}
    assert all(one["depth_share"] == pytest.approx(1, abs=0.15) for one in lifted)


def test_no_lift_is_said_without_its_press(
    station: SteppedStation, said: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither when its press ends before the look at that frame, and what lasts is said again just then."""
    monkeypatch.setattr("edge.features.contact_state._PRESSED_S", 0.0)
    watch = station.find(ContactWatch)
    assert watch is not None
    station.play_until(lambda: watch.follower.state == "lift")
    watch.see(PressEnded(station.clock.monotonic_ns(), sequence=1, began_ns=0))
    assert all(one["press_id"] for one in said if one["state"] == "lift")


def test_what_lasts_is_said_again(station: SteppedStation, said: list[dict[str, Any]]) -> None:
    """Five times a second while something touches, every two seconds while nothing does: who hears nothing knows."""
    station.play()
    times = [one["time_ns"] for one in said]
    pauses = [(later - earlier) / 1e9 for earlier, later in pairwise(times)]
    for one, pause in zip(said, pauses, strict=False):
        assert pause < (2.2 if one["state"] in ("free", "unknown") else 0.42)
    assert len(said) < 1 + 7 * 3 + 5 * times[-1] / 1e9


def test_frames_that_show_nothing_leave_it_unknown(
    station: SteppedStation, said: list[dict[str, Any]]
) -> None:
    """Not between two frames: after a pause as long as an interruption."""
    station.play_until(lambda: bool(said) and said[-1]["state"] == "lift")
    watch = station.find(ContactWatch)
    watch.turn(None)
    assert said[-1]["state"] == "lift"
    station.clock.sleep(GAP_S + 0.1)
    assert watch._look is not None
    watch.look(replace(watch._look, timestamp_ns=station.clock.monotonic_ns(), seen=None))
    assert said[-1]["state"] == "unknown"


def test_frames_that_waited_while_nobody_looked_end_no_loss(
    station: SteppedStation, said: list[dict[str, Any]]
) -> None:
    """The loop recorded for half a second: `lift` of the part that lay there before is not said over the next one."""
    station.play_until(lambda: bool(said) and said[-1]["state"] == "lift")
    watch = station.find(ContactWatch)
    assert watch._look is not None
    begun_ns = station.clock.monotonic_ns()
    station.clock.sleep(0.6)
    watch.turn(None)
    for made_ns, state in ((begun_ns + 10**8, "unknown"), (begun_ns + 7 * 10**8, "lift")):
        station.clock.sleep(0.11)
        watch.take(CameraFrame(b"", made_ns, 1))
        watch.look(replace(watch._look, timestamp_ns=made_ns, sight=Mock(seen_ns=made_ns)))
        watch.turn(None)
        assert said[-1]["state"] == state


def test_a_turn_that_waited_shows_no_lift_at_its_end(
    station: SteppedStation, said: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A feature waited for a locked database after the look: nobody has seen since what lies there."""
    station.play_until(lambda: bool(said) and said[-1]["state"] == "lift")
    words, shown = station.find(PersonVerdicts), []
    monkeypatch.setattr(words, "turn", lambda mounted: station.clock.sleep(2.0))
    monkeypatch.setattr(words, "show", lambda view: shown.append(view.contact))
    station.play(1)
    assert (said[-1]["state"], shown) == ("unknown", ["unknown"])


def test_a_station_ended_or_halted_says_nothing(station: SteppedStation, said: list[dict[str, Any]]) -> None:
    station.play_until(lambda: bool(said) and said[-1]["state"] == "lift")
    with station.refusing("acts"):
        station.parts.selection.inspector.fault = "a test"
        station.turn()
        assert said[-1]["state"] == "unknown"
        assert said[-1]["press_id"] is None
        station.parts.selection.inspector.fault = None
    station.turn()
    assert said[-1]["state"] == "lift"
    station.find(ContactWatch).close()
    assert said[-1]["state"] == "unknown"


def test_an_overload_is_an_alarm_until_a_free_gel(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """At the first frame, before the press is confirmed; it is counted, and each is an act."""
    weak = variant(bundle, tmp_path / "weak", strength={"lowest": 1.0, "middle": 1.0, "highest": 1.0})
    with SteppedStation(station_config(tmp_path, recording, weak)) as station:
        station.turn()
        for number in (1, 2, 3):
            station.play_until(lambda: station.said("contact")["state"] == "overload")
            assert len(station.reports) == number - 1
            alarm = str(station.alarm("gel_overload"))
            assert alarm.startswith("the imprint is more than 2 times as strong")
            assert f"; {number} since the start" in alarm
            station.play_until(lambda: station.said("contact")["state"] != "overload")
            assert station.said("contact")["state"] == "free"
            assert station.alarm("gel_overload") is None
        station.play()
        acts = [act for act in station.parts.store.acts(10) if act.verb == "overload"]
    assert len(acts) == 3
    assert all(act.arguments["depth_share"] > 1.6 for act in acts)


def test_a_file_of_messages_has_no_stream(config: Path, tmp_path: Path) -> None:
    """Each line is flushed to the disk: what changes at every moment would fill it."""
    with SteppedStation(config) as station:
        station.play()
        station.publish()
    lines = [json.loads(line) for line in next(tmp_path.rglob("messages.jsonl")).read_text().splitlines()]
    topics = {line["topic"] for line in lines}
    assert "result" in topics
    assert "contact" not in topics
