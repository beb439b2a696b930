"""Snapshots: the frames around a moment, as a recording, bounded in memory and on the disk."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest
from station import Configure
from stepped_station import SteppedStation
from waiting import wait_until

from edge.clock import ManualClock
from edge.core.errors import StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import DeviceIdentity
from edge.features import snapshots
from edge.features.snapshots import Snapshots
from edge.recording.format import Recording
from edge.store.acts import Act

SERVED = '[commands]\nunsigned = ["snapshot"]\n'
SENSOR = DeviceIdentity("GelSight Mini", "S1", (64, 48), 10.0)


def frame(number: int, size: int = 10) -> CameraFrame:
    """Frames come ten times a second."""
    return CameraFrame(b"\xff\xd8" + bytes(size) + b"\xff\xd9", number * 10**8, number)


def bench(folder: Path, frames: int = 100, size: int = 10) -> Snapshots:
    found = made(folder, ManualClock())
    for number in range(frames):
        found.take(frame(number, size))
    return found


def made(folder: Path, clock: ManualClock) -> Snapshots:
    parts = Mock(clock=clock, find_sensor=lambda: SENSOR, find_low_space=lambda: None)
    parts.config.store.path = folder / "gelgate.db"
    return Snapshots(parts)


def written(found: Snapshots) -> Act:
    """The loop's turn, the thread's turn, the loop's turn."""
    found.turn(None)
    found.worker.step()
    found.turn(None)
    return found._store.begin_act.call_args.args[0]


def test_the_frames_around_the_request_are_written(tmp_path: Path) -> None:
    """From half a second before it to 0.3 s after it; the recording is there when the last frame has come."""
    found = bench(tmp_path)
    folder = found.request(0.5, 0.3)
    for number in (100, 101, 102):
        found.turn(None)
        found.worker.step()
        assert not folder.exists()
        found.take(frame(number))
    act = written(found)
    recording = Recording.open(folder)

    assert [one.frame.timestamp_ns for one in recording] == [number * 10**8 for number in range(94, 103)]
    assert recording.header.identity == SENSOR
    assert (act.who, act.verb, act.outcome) == ("the gateway", "snapshot", "done")
    assert act.after == {"recording": str(folder), "frames": 9, "bytes": 9 * 14}


def test_the_thread_of_a_station_that_runs_writes_it(tmp_path: Path) -> None:
    found = bench(tmp_path)
    found.start()
    folder = found.request(0.5, 0.3)
    for number in (100, 101, 102):
        found.take(frame(number))
    found.turn(None)
    wait_until(folder.exists)
    found.close()


def test_a_stream_that_stops_does_not_hold_back_what_is_there(tmp_path: Path) -> None:
    """The frames after the request never come; after a time those before it are written."""
    clock = ManualClock()
    found = made(tmp_path, clock)
    found.take(frame(0))
    folder = found.request(1, 1)
    found.turn(None)
    clock.sleep(1 + snapshots.PATIENCE_S)
    written(found)

    assert len(Recording.open(folder)) == 1


@pytest.mark.parametrize(("after_s", "numbers"), [(0.3, [300, 301, 302]), (0, [])])
def test_what_comes_after_a_request_without_a_sensor_is_written(
    tmp_path: Path, after_s: float, numbers: list[int]
) -> None:
    """Its frames ended 20 s before the request, and leave the memory when others come; of none nothing is written."""
    clock = ManualClock()
    found = made(tmp_path, clock)
    found.take(frame(99))
    clock.sleep(28.95)
    folder = found.request(0, after_s)
    for number in range(300, 310):
        found.take(frame(number))
    act = written(found)

    assert (act.outcome, folder.exists()) == (("done", True) if numbers else ("failed", False))
    if numbers:
        assert [one.frame.timestamp_ns // 10**8 for one in Recording.open(folder)] == numbers
    else:
        assert "no frame came" in (act.sentence or "")


def test_memory_is_bounded_by_time_and_by_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large frames leave early, small ones after twenty seconds."""
    monkeypatch.setattr(snapshots, "RING_BYTES", 10_000)
    small = bench(tmp_path, frames=500)
    large = bench(tmp_path, frames=500, size=1000)

    assert len(small._ring) == 201
    assert len(large._ring) == 9
    assert large._bytes == sum(len(one.payload) for one in large._ring) <= snapshots.RING_BYTES


def test_a_snapshot_has_its_name_when_it_is_complete(tmp_path: Path) -> None:
    """While its frames are written the name is hidden; what a killed process left hidden is removed."""
    folder = tmp_path / "gelgate.snapshots"
    (folder / ".left").mkdir(parents=True)
    names: list[list[str]] = []

    class Watched(list[CameraFrame]):
        def __iter__(self) -> Iterator[CameraFrame]:
            for one in super().__iter__():
                yield one
                names.append([path.name for path in folder.iterdir()])

    found = bench(tmp_path)
    name = found.request(1, 0).name
    found.turn(None)
    path, frames, header = found.worker._job.args
    found.worker.ask(partial(found._save, path, Watched(frames), header))
    found.worker.step()

    assert names[-1] == [f".{name}"]
    assert [path.name for path in folder.iterdir()] == [name]


def test_the_oldest_snapshots_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By their number and by their bytes."""
    found = bench(tmp_path)
    monkeypatch.setattr(snapshots, "KEPT", 3)
    names = []
    for _ in range(5):
        names.append(found.request(1, 0).name)
        written(found)
        found._clock.sleep(1)
    assert sorted(path.name for path in (tmp_path / "gelgate.snapshots").iterdir()) == names[-3:]

    monkeypatch.setattr(snapshots, "KEPT_BYTES", 1500)  # one has 1 kB with its index
    last = found.request(1, 0).name
    written(found)
    assert [path.name for path in sorted((tmp_path / "gelgate.snapshots").iterdir())] == [names[-1], last]


def test_one_snapshot_is_made_at_a_time(tmp_path: Path) -> None:
    """A second request is refused, and served when the first is written."""
    found = bench(tmp_path)
    found.request(1, 0)
    with pytest.raises(ValueError, match="another snapshot is being written"):
        found.request(1, 0)
    written(found)
    found.request(1, 0)


def test_a_disk_that_refuses_is_an_act_with_the_reason(tmp_path: Path) -> None:
    """Nothing is left of it, and inspection does not notice."""
    found = bench(tmp_path)
    (tmp_path / "gelgate.snapshots").write_text("no folder")
    folder = found.request(1, 0)
    act = written(found)

    assert act.outcome == "failed"
    assert act.sentence is not None
    assert act.sentence.startswith(f"snapshot {folder} is not written: ")


def test_an_outcome_that_the_database_refuses_is_written_later(tmp_path: Path) -> None:
    """Each snapshot has one row in the table of acts; one that was asked for meanwhile waits for it."""
    found = bench(tmp_path)
    folders = [found.request(1, 0)]
    found.turn(None)
    found.worker.step()
    found._clock.sleep(1)
    folders.append(found.request(1, 0))
    found._store.begin_act.side_effect = StoreError("no room")
    for _ in range(2):
        with pytest.raises(StoreError, match="no room"):
            found.turn(None)
        found.worker.step()
    found._store.begin_act = Mock()
    for _ in range(3):
        found.turn(None)
        found.worker.step()

    acts = [call.args[0] for call in found._store.begin_act.call_args_list]
    assert [act.after["recording"] for act in acts] == list(map(str, folders))


def test_a_snapshot_of_a_station_is_a_recording_of_its_sensor(configure: Configure, tmp_path: Path) -> None:
    """Below the state folder, with a row in the table of acts; presses are judged as without it."""
    with SteppedStation(configure(tables=SERVED)) as station:
        with pytest.raises(ValueError, match="no frame has arrived"):
            station.ask("snapshot", before_s=5, after_s=0)
        station.play_until(lambda: len(station.reports) == 1)
        folder = Path(station.ask("snapshot", before_s=0.5, after_s=0.2)["recording"])
        station.play()
        station.find(Snapshots).worker.step()
        station.turn()
        acts = station.parts.store.acts()

    assert folder.parent == tmp_path / "gelgate.snapshots"
    assert Recording.open(folder).header.serial == "TEST0001"
    assert [(act.verb, act.outcome) for act in acts] == [("snapshot", "done")]
    assert station.verdicts == ["pass", "fail", "pass"]


@pytest.mark.parametrize(
    ("tables", "store", "words"),
    [("", "", "'snapshot' is off"), (SERVED, "free_mb = 1e9", "no snapshot is written: the disk of")],
)
def test_a_station_that_may_not_says_why(configure: Configure, tables: str, store: str, words: str) -> None:
    """It does not serve the request, as a station comes, or there is little room: the disk is the database's."""
    config = configure(tables=tables, store=store)
    with SteppedStation(config) as station, pytest.raises(ValueError, match=words):
        station.ask("snapshot", before_s=5, after_s=0)
