"""A disk that fills up while presses come in."""

import json
import subprocess
import sys
from pathlib import Path

import gateway_on_a_full_disk
from station import press_recording, station_config

from edge.store.press_store import Store

PROGRAM = Path(gateway_on_a_full_disk.__file__)


def test_a_full_disk_halts_the_station_and_loses_no_press(tmp_path: Path, bundle: Path) -> None:
    """The press that finds no room is kept: reported as a halt and an alarm, recorded once there is room.

    Each press is counted once and published once; the alarm is cleared and the station goes on.
    """
    recording = press_recording(tmp_path / "presses", 2, seed=2)
    config = station_config(tmp_path, recording, bundle)
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(config)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])

    assert seen == {"recorded_while_halted": 1, "presses": 2}
    with Store(tmp_path / "gelgate.db") as store:
        ids = [press.press_id for press, _ in reversed(store.presses())]
        assert [gel.presses for gel in store.gels()] == [2]
    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    published = [line["payload"]["press_id"] for line in lines if line["topic"] == "result"]
    assert list(dict.fromkeys(published)) == ids  # an acknowledgement that finds no room means: sent again
    alarms = [line["payload"] for line in lines if line["topic"] == "alarm/store"]
    halted = next(index for index, alarm in enumerate(alarms) if alarm)
    assert "free space" in alarms[halted]["text"]
    assert alarms[-1] is None
    states = [line["payload"]["state"] for line in lines if line["topic"] == "state"]
    # The recording may be over before there is room; then nothing is ready any more.
    after = states[states.index("halted") + 1 :]
    assert after in (["ready", "stopped"], ["stopped"])
