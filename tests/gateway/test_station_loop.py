"""The station's loop, one step at a time: nothing sleeps, and a test decides the order."""

import threading
from contextlib import suppress
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config, two_parts
from stepped_station import SteppedStation
from waiting import wait_until

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import DeviceNotFound, StoreError
from edge.gateway import inspection_session
from edge.gateway.build import open_station
from edge.gateway.recorder import PressReport
from edge.messaging.command_payloads import SelectPartArguments
from edge.store.press_store import Store

# Of the recording: the reader's first step opens it.
FREE_FRAMES, PRESS_FRAMES = 1 + Motion().free, Motion().hold + Motion().idle


@pytest.mark.parametrize("verb", ["relearn", "replace_gel", "trigger"])
def test_nothing_can_be_asked_of_a_gel_before_the_sensor_is_known(station: SteppedStation, verb: str) -> None:
    with pytest.raises(DeviceNotFound, match="no frame has arrived"):
        station.ask(verb)


def test_a_part_can_be_selected_before_the_sensor_is_known(station: SteppedStation) -> None:
    """The answer has the part in use; a name that is not known is refused with those that are."""
    found = station.ask("select_part", part="PZ0")
    assert (found["part"], found["position"], found["is_waiting"]) == ("PZ0", "pos1", False)
    with pytest.raises(ValueError, match="this station has no bundle for 'PZ9'; it has PZ0/pos1"):
        station.ask("select_part", part="PZ9")
    with pytest.raises(ValueError, match="expected either part, with or without position, or name"):
        SelectPartArguments.of({"part": "PZ0", "name": "PZ0"})


@pytest.mark.parametrize(
    ("verb", "arguments", "trigger", "seen", "first"),
    [
        ("trigger", {}, "command", 3, ("rejected", "PZ0", "TEST0001-1")),
        ("select_part", {"part": "PZ1"}, "automatic", 0, ("pass", "PZ0", "TEST0001-1")),
        ("replace_gel", {"gel_id": "next"}, "automatic", 0, ("pass", "PZ0", "TEST0001-1")),
    ],
)
def test_no_request_acts_on_a_press_that_was_over_before_it(
    tmp_path: Path,
    recording: Path,
    bundle: Path,
    verb: str,
    arguments: dict[str, str],
    trigger: str,
    seen: int,
    first: tuple[str, ...],
) -> None:
    """The loop has looked at the first `seen` frames of a press when the request comes. The press has no verdict by
    command, and is of the part and the gel of before."""
    line = two_parts(tmp_path / "bundles", bundle) + '\npart = "PZ0"'
    config = station_config(tmp_path, recording, line, trigger=trigger, pace=1.0)
    with SteppedStation(config) as station:
        station.play(FREE_FRAMES + seen)
        station.read(PRESS_FRAMES - seen)
        station.parts.calls.post(lambda loop: station.ask(verb, **arguments))
        with suppress(ValueError):
            station.look()
            station.play_presses(1)
        pressed = station.results[0]
    assert (pressed.verdict, pressed.part, pressed.gel_id) == first


@pytest.mark.parametrize(("hold", "is_at_rest"), [(2, None), (3, False), (8, True)])
def test_a_result_tells_of_rest(tmp_path: Path, bundle: Path, hold: int, is_at_rest: bool | None) -> None:
    """At 25 frames a second 8 frames are a rest, of 3 the peak is judged after the lift, and of 2 nothing."""
    film = press_recording(tmp_path / "film", 1, motion=Motion(hold=hold, idle=10), seed=4)
    with SteppedStation(station_config(tmp_path, film, bundle)) as station:
        station.play_presses(1)
        (pressed,) = station.results
    assert (pressed.is_at_rest, pressed.verdict) == (is_at_rest, "rejected" if hold == 2 else "pass")


def test_a_requested_reload_is_served_by_the_bundles_thread(station: SteppedStation) -> None:
    """The answer comes at once; the outcome is an act of the gateway."""
    assert station.ask("reload") == {"is_waiting": True}
    station.turn()
    assert station.parts.store.acts() == []
    station.parts.selection.worker.step()
    station.turn()
    assert [act.verb for act in station.parts.store.acts()] == ["open_bundles"]


def test_a_new_gel_starts_from_nothing(station: SteppedStation) -> None:
    """Its count is 0, its picture is learnt again, and the sequence of presses continues."""
    station.play_until(lambda: bool(station.reports))
    answer = station.ask("replace_gel", gel_id="next", limit_presses=7)
    state = station.said("state")

    assert answer == {"gel_id": "next", "presses": 0, "limit_presses": 7, "remarks": []}
    assert (state["state"], state["reason"]) == (
        "starting",
        "waiting for two seconds of the free gel, to learn its picture",
    )
    with pytest.raises(StoreError, match="'next' was already used"):
        station.ask("replace_gel", gel_id="next")


def test_a_loop_that_hangs_is_said_while_it_hangs(config: Path) -> None:
    """A disk holds it in the turn of its first press: receivers do not keep `ready`, and with it the last pass."""
    clock, stop, is_held, may_go = SystemClock(), threading.Event(), threading.Event(), threading.Event()

    def hang(report: PressReport) -> None:
        is_held.set()
        may_go.wait()

    with pytest.MonkeyPatch.context() as patched, open_station(load_config(config), clock, hang) as station:
        patched.setattr("edge.gateway.station_loop.LOOP_S", 0.2)
        patched.setattr("edge.gateway.station_loop.WATCH_S", 0.05)
        runner = threading.Thread(target=station.run, args=(stop, 2))
        runner.start()
        is_held.wait()
        wait_until(lambda: station.parts.status.view().state == "halted")
        said = [message.payload for _, message in station.parts.publisher.retained_state.since(-1)]
        assert any(b"the station's loop does not answer; check its disks" in payload for payload in said)
        may_go.set()
        runner.join()
        assert station.parts.status.view().state == "ready"


def test_presses_that_the_store_refuses_are_kept_and_recorded_when_possible(station: SteppedStation) -> None:
    """Halted with a reason while it lasts; commands are still answered; then all three, in order, once, each with its
    verdict."""
    with station.refusing("presses"):
        station.play()
        station.turn()
        assert station.loop.is_halted
        assert station.reports == []
        assert station.ask("relearn")["state"]
        state = station.said("state")
    station.turn()

    assert not station.loop.is_halted
    assert (state["state"], "no room" in state["reason"]) == ("halted", True)
    assert [result.sequence for result in station.results] == [1, 2, 3]
    assert station.verdicts == ["pass", "fail", "pass"]


def test_presses_that_find_no_room_to_wait_are_counted_on_the_gel(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory is bounded: what does not fit has no result, and the gel has felt it."""
    monkeypatch.setattr(inspection_session, "MOST_WAITING", 1)
    with station.refusing("presses"):
        station.play()
    station.turn()

    assert len(station.reports) == 1
    assert station.loop.session.gel.presses == 3


def test_a_gateway_that_ends_while_the_database_refuses_leaves_the_count_to_the_next(config: Path) -> None:
    """A verdict that was not stored is an error of the run, not a line in a log. Ended or killed: the next start counts
    the presses and raises the alarm `counts`."""
    with SteppedStation(config) as station, station.refusing("presses"):
        station.play()
        (stop := threading.Event()).set()
        with pytest.raises(StoreError, match="no room"):
            station.loop.turn_until(stop)

    with SteppedStation(config) as station:
        station.play(3)
        station.loop.publish_stats()
        alarm = str(station.alarm("counts"))
    with Store(config.parent / "gelgate.db") as store:
        (gel,) = store.gels()

    assert gel.presses == 3
    assert "3 presses of sensor TEST0001 were made while it refused writes" in alarm


def test_a_lost_database_is_an_alarm_of_the_station(config: Path) -> None:
    """The gel goes on counting, and a person is asked to look."""
    with SteppedStation(config) as station:
        station.play()
    for name in ("gelgate.db", "gelgate.db-wal", "gelgate.db-shm"):
        (config.parent / name).unlink(missing_ok=True)

    with SteppedStation(config) as station:
        station.play(3)
        assert station.loop.session.gel.presses == 3
        assert "presses 1 to 3 are missing" in str(station.alarm("counts"))
