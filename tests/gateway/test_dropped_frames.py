"""A station on a machine that is too slow: what it lost is counted, published and cleared, and held presses survive."""

import json
import threading
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport
from edge.recording.format import Recording


@pytest.fixture(scope="module")
def long_presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return press_recording(
        tmp_path_factory.mktemp("long") / "presses", 2, motion=Motion(hold=60, idle=20), seed=7
    )


def test_frames_dropped_during_a_press_interrupt_it_and_raise_the_alarm(
    tmp_path: Path, bundle: Path, long_presses: Path
) -> None:
    """The loop stops for some seconds in the middle of a held press: one verdict all the same, and an alarm."""
    config = load_config(station_config(tmp_path, long_presses, bundle))
    reports: list[PressReport] = []
    fed = 0
    with Gateway.open(config, SystemClock(), reports.append) as gateway:
        is_behind = threading.Event()
        look_at = gateway._look_at

        def slow(frame: object) -> None:
            nonlocal fed
            fed += 1
            if fed == 34:  # pressed since frame 28, not yet decided
                before = gateway.status.dropped
                while gateway.status.dropped == before:
                    is_behind.wait(0.01)
            look_at(frame)  # type: ignore[arg-type]

        gateway._look_at = slow  # type: ignore[method-assign]
        summary = gateway.run(threading.Event())

    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    alarms = [line["payload"] for line in lines if line["topic"] == "alarm/overload"]
    stats = [line["payload"] for line in lines if line["topic"] == "stats"][-1]
    assert len(reports) == 2
    assert summary.frames.dropped > 0
    assert summary.frames.interrupted >= 1
    assert stats["frames_dropped"] == summary.frames.dropped
    assert any(alarm and "too slow" in alarm["text"] for alarm in alarms)
    assert summary.frames.frames == len(Recording.open(long_presses))
