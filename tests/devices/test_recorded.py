"""The recorded device: recorded intervals, and faults of its folder."""

from itertools import pairwise
from pathlib import Path

import pytest
from small_recordings import PERIOD_NS, SERIAL, jpeg, write_recording

from edge.clock import ManualClock
from edge.core.errors import RecordingEnded, RecordingError
from plugins.devices.recorded import RecordedOptions, plugin


@pytest.mark.parametrize(("pace", "expected_ns"), [(1.0, 3 * PERIOD_NS), (2.0, 3 * PERIOD_NS / 2), (0.0, 0)])
def test_pace(tmp_path: Path, pace: float, expected_ns: float) -> None:
    """Four frames are three intervals; twice as fast halves them; 0 waits for nothing."""
    clock = ManualClock()
    device = plugin.open(RecordedOptions(recording=write_recording(tmp_path / "r", 4), pace=pace), clock)
    start = clock.monotonic_ns()
    for _ in range(4):
        device.read(clock.monotonic_ns() + 10**9)
    assert clock.monotonic_ns() - start == pytest.approx(expected_ns, abs=10)


def test_on_demand_a_frame_has_its_recorded_time(tmp_path: Path) -> None:
    """No time passes, and the frames are still a period apart, also from the end to the start of a loop."""
    clock = ManualClock()
    options = RecordedOptions(recording=write_recording(tmp_path / "r", 3), pace=0, loop=True)
    device = plugin.open(options, clock)
    frames = [device.read(clock.monotonic_ns() + 10**9) for _ in range(7)]
    apart = [later.timestamp_ns - earlier.timestamp_ns for earlier, later in pairwise(frames)]

    assert all(frame.is_on_demand for frame in frames)
    assert [apart[k] for k in (0, 1, 3, 4)] == [PERIOD_NS] * 4
    assert all(0 < apart[k] < 2 * PERIOD_NS for k in (2, 5))


def test_loop(tmp_path: Path) -> None:
    """With loop it starts over, at the recorded pace."""
    clock = ManualClock()
    device = plugin.open(RecordedOptions(recording=write_recording(tmp_path / "r", 2), loop=True), clock)
    frames = [device.read(clock.monotonic_ns() + 10**9) for _ in range(5)]
    assert [frame.payload for frame in frames] == [jpeg(seed) for seed in (0, 1, 0, 1, 0)]


def test_an_empty_recording_is_over_at_once(tmp_path: Path) -> None:
    """No frames, with loop or without, is an end and not an endless loop."""
    clock = ManualClock()
    for loop in (False, True):
        folder = write_recording(tmp_path / f"r{loop}", 0)
        with pytest.raises(RecordingEnded):
            plugin.open(RecordedOptions(recording=folder, loop=loop), clock).read(
                clock.monotonic_ns() + 10**9
            )


def test_survey(tmp_path: Path) -> None:
    """A good folder is a sensor; a bad one is a refusal with the reason."""
    good = RecordedOptions(recording=write_recording(tmp_path / "r", 1))
    assert [one.identity and one.identity.serial for one in plugin.discover(good)] == [SERIAL]
    bad = RecordedOptions(recording=tmp_path)
    (seen,) = plugin.discover(bad)
    assert seen.identity is None
    assert "not a recording" in (seen.refusal or "")
    with pytest.raises(RecordingError):
        plugin.open(bad, ManualClock())
