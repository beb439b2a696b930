"""The last day of use of the mounted gel: an alarm after it, whatever the clock does."""

from datetime import datetime, timedelta
from pathlib import Path

import pytest
from stepped_station import SteppedStation

from edge.core.errors import StoreError
from edge.core.gel_life import GelLabel
from edge.features.gel_date import GelDateWatch
from edge.store.gel_ledger import GelRecord


class SetClock:
    """A wall clock that somebody may set, and a running time."""

    def __init__(self, local: str) -> None:
        self._wall = datetime.fromisoformat(local)
        self._running = timedelta()

    def set(self, local: str) -> None:
        self._wall = datetime.fromisoformat(local)

    def monotonic_ns(self) -> int:
        return round(self._running.total_seconds()) * 10**9

    def time_ns(self) -> int:
        return round(self._wall.timestamp()) * 10**9

    def sleep(self, seconds: float) -> None:
        self._wall += timedelta(seconds=seconds)
        self._running += timedelta(seconds=seconds)


class Said:
    """Every change of the alarm."""

    def __init__(self) -> None:
        self.texts: list[str | None] = []

    def say(self, alarm: str, sentence: str | None, severity: str = "error") -> None:
        assert alarm == "gel_expired"
        if sentence != [None, *self.texts][-1]:
            self.texts.append(sentence)


def mounted(gel_id: str, use_by: str | None) -> GelRecord:
    return GelRecord("S", gel_id, 0, 1000, 0.8, 0, use_by=use_by)


def watch(local: str, use_by: str | None = "2027-01-31") -> tuple[GelDateWatch, SetClock, Said]:
    clock, said = SetClock(local), Said()
    stage = GelDateWatch(said, clock)  # type: ignore[arg-type]  # `say` is all that it uses
    stage.mount(mounted("S-1", use_by))
    return stage, clock, said


def play(stage: GelDateWatch, clock: SetClock, seconds: float, step_s: float = 0.5) -> None:
    for _ in range(int(seconds / step_s)):
        stage.turn(None)
        clock.sleep(step_s)


PAST = "gel S-1 is past its use-by date 2027-01-31"


@pytest.mark.usefixtures("tokyo")
def test_the_alarm_comes_at_the_end_of_the_last_day_of_this_place() -> None:
    """At midnight by the local clock, which is 15:00 of the last day in UTC; it stays."""
    stage, clock, said = watch("2027-01-31T23:59:50")
    play(stage, clock, 9)
    assert said.texts == []
    play(stage, clock, 3600)
    assert said.texts == [PAST]


def test_a_clock_that_steps_to_and_fro_does_not_end_it() -> None:
    """Around midnight, an hour back, and to 1970 at a restart of the time server: one alarm. A clock that stays at an
    earlier day for hours was wrong before."""
    stage, clock, said = watch("2027-01-31T23:59:58")
    for day in ("2027-02-01T00:00:01", "2027-01-31T23:00:00", "2027-02-01T00:00:00", "1970-01-01T00:00:00"):
        clock.set(day)
        play(stage, clock, 600)
    assert said.texts == [PAST]
    clock.set("2027-01-20T12:00:00")
    play(stage, clock, 2 * 3600 + 2)
    assert said.texts == [PAST, None]


def test_another_gel_ends_it_and_one_without_a_date_raises_none() -> None:
    """At once; one that is past its own date raises it anew."""
    stage, clock, said = watch("2027-02-03T12:00:00")
    play(stage, clock, 2)
    stage.mount(mounted("S-2", None))
    play(stage, clock, 2)
    stage.mount(mounted("S-3", "2027-02-02"))
    play(stage, clock, 2)
    assert said.texts == [PAST, None, "gel S-3 is past its use-by date 2027-02-02"]


def test_a_station_says_what_the_package_said(config: Path) -> None:
    """At the request, in the gel's topic and in each result; the alarm comes at once, and after a restart. The clock of
    this station shows 1970. Presses are judged as before."""
    past = {"gel_serial": "G7", "gel_type": "plain", "use_by": "1969-12-30"}
    with SteppedStation(config) as station:
        station.play(3)
        answer = station.ask("replace_gel", **past)
        station.play_presses(1)
        said, (result,) = station.said("gel"), station.results
        raised = station.alarm("gel_expired")
    with SteppedStation(config) as again:
        again.play(3)
        restarted = again.alarm("gel_expired")
        corrected = again.ask("replace_gel", gel_serial="G7", use_by="2027-01-31")
        ended = again.alarm("gel_expired")

    assert answer["remarks"] == ["gel TEST0001-2 is past its use-by date 1969-12-30: mount another one"]
    assert {name: said[name] for name in past} == past
    assert (result.gel_serial, result.verdict) == ("G7", "pass")
    assert raised == restarted == "gel TEST0001-2 is past its use-by date 1969-12-30"
    assert corrected["remarks"] == [
        "gel serial 'G7' was mounted before: its count goes on from 1 of 1000 presses"
    ]
    assert ended is None


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"use_by": "2027-02-29"}, "no day of the calendar"),
        ({"gel_serial": "G9"}, "is on sensor OTHER"),
        ({"gel_id": "G" * 65}, "at most 64"),
    ],
)
def test_a_wrong_request_changes_nothing(config: Path, arguments: dict[str, str], sentence: str) -> None:
    """The gel stays mounted."""
    with SteppedStation(config) as station:
        station.play(3)
        station.parts.store.replace_gel("OTHER", 1, label=GelLabel("G9"))
        with pytest.raises((ValueError, StoreError), match=sentence):
            station.ask("replace_gel", **arguments)
        assert station.loop.session.gel.gel_id == "TEST0001-1"
