"""The robot of examples/lift_when_judged.py at a real broker, beside a station with a virtual sensor."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from station import MQTT, press_recording, small_bundle, station_config, variant

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.messaging.local_broker import LocalBroker, available_brokers

ROBOT = Path(__file__).resolve().parents[2] / "examples" / "lift_when_judged.py"
ROOT = "gelgate/site/line/station/gel/v1"


@pytest.mark.parametrize("strength", [None, 1.0], ids=["as deep as at fit", "far deeper"])
def test_the_robot_lifts_each_part_once_when_its_verdict_is_recorded(
    tmp_path: Path, strength: float | None
) -> None:
    """In real time: once for each press, with its id. Where presses are too deep it is told to go back instead."""
    if "mosquitto" not in available_brokers():
        pytest.skip("SKIPPED, NOT TESTED: mosquitto is not installed")
    bundle = small_bundle(tmp_path / "bundle", press_recording(tmp_path / "nominal", 12, seed=1))
    if strength is not None:
        known = {"lowest": strength, "middle": strength, "highest": strength}
        bundle = variant(bundle, tmp_path / "weak", strength=known)
    recording = press_recording(tmp_path / "presses", 3, dented=[1], seed=2)
    with LocalBroker("mosquitto") as broker:
        words = [sys.executable, str(ROBOT), "127.0.0.1", str(broker.port), ROOT]
        robot = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        ids: list[str] = []
        try:
            config = station_config(tmp_path, recording, bundle, sinks=MQTT % broker.port, pace=1)
            with open_station(
                load_config(config), SystemClock(), lambda report: ids.append(report.result.press_id)
            ) as gateway:
                gateway.run(threading.Event())
        finally:
            robot.terminate()
            said = robot.communicate(timeout=20)[0].splitlines()
    assert len(ids) == 3
    if strength is None:
        assert said == [f"lift {press_id}" for press_id in ids]
    else:
        assert set(said) == {"retreat"}
