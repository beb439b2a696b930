"""The alarm before the disk is full."""

import json
from pathlib import Path

import pytest
from station import station_config
from stepped_station import SteppedStation

from edge.gateway.report import FreeSpace, free_bytes

DATABASE = Path("/var/lib/gelgate/gelgate.db")


def low(warn_bytes: int, *answers: int | None) -> list[bool]:
    """Whether there is an alarm after each answer of the disk."""
    remaining = iter(answers)
    space = FreeSpace(DATABASE, warn_bytes, lambda path: next(remaining))
    return [space.check() is not None for _ in answers]


def test_the_alarm_begins_below_the_limit_and_ends_well_above_it() -> None:
    """A disk that changes by a little around the limit raises it once."""
    assert low(1000, 1000, 999, 1050, 1099, 1100, 1050, 999) == [False, True, True, True, False, False, True]


def test_no_limit_no_alarm() -> None:
    """`free_mb = 0`: only the full disk itself is reported."""
    assert low(0, 5, 0) == [False, False]


def test_a_disk_that_cannot_be_asked_is_no_alarm(tmp_path: Path) -> None:
    """The database will say what is wrong with it."""
    assert low(1000, None) == [False]
    assert free_bytes(tmp_path / "gone" / "gelgate.db") is None


def test_the_sentence_says_how_much_and_what_to_do() -> None:
    """In megabytes, with the key of the limit."""
    assert FreeSpace(DATABASE, 500_000_000, lambda path: 123_456_789).check() == (
        "the disk of /var/lib/gelgate/gelgate.db has 123 MB free, fewer than 500 (store.free_mb); free space before "
        "it is full: then inspection halts"
    )


@pytest.mark.parametrize(("free_mb", "is_raised"), [(1_000_000_000, True), (0, False)])
def test_a_running_station_raises_it_and_goes_on(
    tmp_path: Path, recording: Path, bundle: Path, free_mb: int, is_raised: bool
) -> None:
    """A warning: presses are still recorded; the room is in the stats."""
    config = station_config(tmp_path, recording, bundle)
    config.write_text(config.read_text().replace("[store]", f"[store]\nfree_mb = {free_mb}"))
    with SteppedStation(config) as station:
        station.play()
        station.loop.publish_stats()
        state = {
            message.topic: message.payload for _, message in station.parts.publisher.retained_state.since(-1)
        }

    assert len(station.reports) == 3
    assert (b"free space before it is full" in state["alarm/disk"]) == is_raised
    assert json.loads(state["stats"])["disk_free_bytes"] > 0
