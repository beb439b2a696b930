"""The alarm before the disk is full."""

from pathlib import Path

import pytest
from station import Configure
from stepped_station import SteppedStation

from edge.gateway.report import FreeSpace, free_bytes


@pytest.mark.parametrize(
    ("limit", "answers", "alarms"),
    [
        (1000, [1000, 999, 1050, 1099, 1100, 1050, 999], [False, True, True, True, False, False, True]),
        (0, [5, 0], [False, False]),
        (1000, [None], [False]),  # a disk that cannot be asked: the database will say what is wrong with it
    ],
)
def test_the_alarm_begins_below_the_limit_and_ends_well_above_it(
    tmp_path: Path, limit: int, answers: list[int | None], alarms: list[bool]
) -> None:
    """A disk that changes by a little around the limit raises it once."""
    remaining = iter(answers)
    space = FreeSpace(tmp_path / "gelgate.db", limit, lambda path: next(remaining))
    assert [space.check() is not None for _ in answers] == alarms
    assert free_bytes(tmp_path / "gone" / "gelgate.db") is None


@pytest.mark.parametrize(("free_mb", "is_raised"), [(1_000_000_000, True), (0, False)])
def test_a_running_station_raises_it_and_goes_on(configure: Configure, free_mb: int, is_raised: bool) -> None:
    """A warning: presses are still recorded; the room is in the stats."""
    with SteppedStation(configure(store=f"free_mb = {free_mb}")) as station:
        station.play()
        station.loop.publish_stats()

    assert len(station.reports) == 3
    assert ("free space before it is full" in str(station.alarm("disk"))) == is_raised
    assert station.said("stats")["disk_free_bytes"] > 0
