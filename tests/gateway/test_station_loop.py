"""The station's loop, one step at a time: nothing sleeps, and a test decides the order."""

import json
from pathlib import Path

import pytest
from station import station_config
from stepped_station import SteppedStation

from edge.core.errors import DeviceNotFound, StoreError
from edge.gateway.command_table import COMMANDS, Command
from edge.messaging.command_payloads import CommandArguments

VERBS: dict[str, Command[CommandArguments]] = {command.verb: command for command in COMMANDS}


def test_a_recording_gives_its_presses_without_any_time_passing(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Three presses, the second one dented, numbered 1 to 3."""
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        station.play()

    assert [report.result.verdict for report in station.reports] == ["pass", "fail", "pass"]
    assert [report.result.sequence for report in station.reports] == [1, 2, 3]


@pytest.mark.parametrize("verb", ["relearn", "replace_gel", "trigger"])
def test_nothing_can_be_asked_of_a_gel_before_the_sensor_is_known(
    tmp_path: Path, recording: Path, bundle: Path, verb: str
) -> None:
    """The gel is not known. The refusal says that no frame has come yet."""
    with (
        SteppedStation(station_config(tmp_path, recording, bundle)) as station,
        pytest.raises(DeviceNotFound, match="no frame has arrived"),
    ):
        VERBS[verb].do(station.loop, VERBS[verb].arguments.of({}))


def test_a_part_can_be_selected_before_the_sensor_is_known(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The answer has the part in use; a name that is not known is refused with those that are."""
    verb = VERBS["select_part"]
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        found = verb.do(station.loop, verb.arguments.of({"part": "PZ0"}))
        assert (found["part"], found["position"], found["is_waiting"]) == ("PZ0", "pos1", False)
        with pytest.raises(ValueError, match="this station has no bundle for 'PZ9'; it has PZ0/pos1"):
            verb.do(station.loop, verb.arguments.of({"part": "PZ9"}))
        with pytest.raises(ValueError, match="expected either part, with or without position, or name"):
            verb.arguments.of({"part": "PZ0", "name": "PZ0"})


def test_a_requested_reload_is_served_by_the_bundles_thread(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The answer comes at once; the outcome is an act of the gateway."""
    verb = VERBS["reload"]
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        assert verb.do(station.loop, verb.arguments.of({})) == {"is_waiting": True}
        station.loop.step(None)
        assert station.parts.store.acts() == []
        station.parts.selection.stage.step()
        station.loop.step(None)
        assert [act.verb for act in station.parts.store.acts()] == ["open_bundles"]


def test_a_press_that_the_store_refuses_is_kept_and_recorded_when_it_can_be(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Halted with a reason while it lasts; commands are still answered; then the same press is recorded, once."""
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.is_halted)
            station.loop.step(None)
            assert station.loop.is_halted
            assert station.reports == []
            assert VERBS["relearn"].do(station.loop, VERBS["relearn"].arguments.of({}))["state"]
            state = {m.topic: m.payload for m in station.parts.publisher.retained_state.all()}["state"]
        station.loop.step(None)
        assert not station.loop.is_halted

    assert json.loads(state)["state"] == "halted"
    assert "no room" in json.loads(state)["reason"]
    assert [report.result.sequence for report in station.reports] == [1]


def test_a_run_that_ends_with_a_press_it_cannot_record_says_so(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """A verdict that was not stored is an error of the run, not a line in a log."""
    import threading

    with SteppedStation(station_config(tmp_path, recording, bundle)) as station, station.refusing("presses"):
        while not station.loop.is_halted:
            station.play(1)
        stop = threading.Event()
        stop.set()
        with pytest.raises(StoreError, match="no room"):
            station.loop.run(stop)


def test_a_new_gel_starts_from_nothing(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Its count is 0, its picture is learnt again, and the sequence of presses continues."""
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        station.play_until(lambda: bool(station.reports))
        replace = VERBS["replace_gel"]
        answer = replace.do(station.loop, replace.arguments.of({"gel_id": "next", "limit_presses": 7}))
        state = json.loads(
            {m.topic: m.payload for m in station.parts.publisher.retained_state.all()}["state"]
        )
        with pytest.raises(StoreError, match="'next' was already used"):
            replace.do(station.loop, replace.arguments.of({"gel_id": "next"}))

    assert answer == {"gel_id": "next", "presses": 0, "limit_presses": 7}
    assert (state["state"], state["reason"]) == ("starting", "waiting for the free gel, to learn its picture")
