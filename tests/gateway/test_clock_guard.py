"""Steps of the wall clock are written down, so that a strange time in the history has its reason."""

from pathlib import Path

import pytest
from stepped_station import SteppedStation

from edge.clock import ManualClock, SystemClock
from edge.gateway.report import ClockGuard


def set_wall(clock: ManualClock, monkeypatch: pytest.MonkeyPatch, set_s: float) -> None:
    """From now on the wall time of the clock is so far from its own."""
    monkeypatch.setattr(clock, "time_ns", lambda: clock.monotonic_ns() + round(set_s * 1e9))


@pytest.mark.parametrize(("set_s", "found"), [(3600.0, 3600.0), (-31 * 86400.0, -31 * 86400.0), (0.5, None)])
def test_a_step_is_found_once(set_s: float, found: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward and back; what a time server corrects slowly is none."""
    guard = ClockGuard(clock := ManualClock())
    clock.sleep(10)
    assert guard.step() is None
    set_wall(clock, monkeypatch, set_s)
    assert (guard.step(), guard.step()) == (found, None)


def test_a_step_is_an_act_of_the_station_also_after_the_store_refused(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is found once, and what could not be recorded then is not forgotten."""
    set_wall(station.clock, monkeypatch, 86400.0)
    with station.refusing("acts"):
        station.loop.publish_stats()
        set_wall(station.clock, monkeypatch, 82800.0)
        station.loop.publish_stats()
    assert station.parts.store.acts() == []
    station.loop.publish_stats()
    acts = station.parts.store.acts()
    assert [act.arguments for act in acts] == [{"seconds": -3600.0}, {"seconds": 86400.0}]
    assert {(act.who, act.verb, act.outcome) for act in acts} == {("the gateway", "clock_step", "done")}


@pytest.mark.parametrize(("first_s", "then_s", "said"), [(86400.0, 60.0, [-86400]), (0.0, 60.0, [])])
def test_a_start_before_the_newest_press_is_an_act(
    first_s: float, then_s: float, said: list[int], config: Path
) -> None:
    """A machine whose clock has no battery starts in the past: its presses are out of order in the history."""
    with SteppedStation(config) as station:
        station.clock.sleep(first_s)
        station.play_until(lambda: len(station.reports) == 1)
    with SteppedStation(config) as station:
        station.clock.sleep(then_s)
        station.loop.publish_stats()
        station.loop.publish_stats()
        acts = [act for act in station.parts.store.acts() if act.verb == "clock_step"]
    assert [act.arguments["seconds"] for act in acts] == pytest.approx(said, abs=100)


def test_a_clock_beyond_2262_loses_no_press(station: SteppedStation, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nanoseconds in 64 bits end there: the station goes on, while the clock is wrong and when it is right again."""
    today_ns = 1_795_000_000 * 10**9
    monkeypatch.setattr(station.clock, "time_ns", SystemClock().time_ns)
    monkeypatch.setattr("time.time_ns", lambda: today_ns + 400 * 365 * 86_400 * 10**9)
    station.play_until(lambda: station.loop.is_halted or len(station.reports) == 1)
    assert not station.loop.is_halted
    monkeypatch.setattr("time.time_ns", lambda: today_ns)
    station.play()

    times = [result.time_ns for result in station.results]
    assert [time_ns == today_ns for time_ns in times] == [False, True, True]
    assert times[0] // 10**9 // 86_400 == 9_214_646_400 // 86_400
