"""The robot of examples/lift_when_judged.py at a real broker, beside a station with a virtual sensor."""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from real_brokers import require
from station import MQTT, press_recording, small_bundle, station_config, variant

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.messaging.local_broker import LocalBroker

ROBOT = Path(__file__).resolve().parents[2] / "examples" / "lift_when_judged.py"
ROOT = "gelgate/site/line/station/gel/v1"


@pytest.mark.parametrize("strength", [None, 1.0], ids=["as deep as at fit", "far deeper"])
def test_the_robot_lifts_each_part_once_when_judged(tmp_path: Path, strength: float | None) -> None:
    """In real time: once for each press, with its id. Where presses are too deep it is told to go back instead. The
    film is shown again until three presses were seen: a machine that is busy elsewhere may miss some."""
    require("mosquitto")
    bundle = small_bundle(tmp_path / "bundle", press_recording(tmp_path / "nominal", 12, seed=1))
    if strength is not None:
        known = {"lowest": strength, "middle": strength, "highest": strength}
        bundle = variant(bundle, tmp_path / "weak", strength=known)
    recording = press_recording(tmp_path / "presses", 3, dented=[1], seed=2)
    enough = threading.Event()
    ids: list[str] = []
    said: list[str] = []
    with LocalBroker("mosquitto") as broker:
        words = [sys.executable, str(ROBOT), "127.0.0.1", str(broker.port), ROOT]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as robot:

            def listen() -> None:
                for line in robot.stdout or ():
                    said.append(line.strip())
                    if len(said) >= 3 and len(ids) >= 3:
                        enough.set()

            listener = threading.Thread(target=listen)
            listener.start()
            late = threading.Timer(120, enough.set)
            late.start()
            try:
                config = station_config(
                    tmp_path, recording, bundle, sinks=MQTT % broker.port, pace=1, loop=True
                )
                with open_station(
                    load_config(config), SystemClock(), lambda report: ids.append(report.result.press_id)
                ) as gateway:
                    gateway.run(enough)
            finally:
                late.cancel()
                robot.terminate()
                listener.join(20)
    assert len(said) >= 3
    if strength is None:
        assert len(set(said)) == len(said)
        assert set(said) <= {f"lift {press_id}" for press_id in ids}
    else:
        assert set(said) == {"retreat"}


def test_the_robot_believes_no_word_that_comes_late() -> None:
    """As those that a broker which hung has kept back: by now another part may lie there. Nor one of a wrong clock."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        station = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        station.connect("127.0.0.1", broker.port)
        station.loop_start()
        station.publish(f"{ROOT}/state", json.dumps({"state": "ready"}), 1, retain=True).wait_for_publish(20)
        words = [sys.executable, str(ROBOT), "127.0.0.1", str(broker.port), ROOT]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as robot:
            lifts: list[str] = []
            reader = threading.Thread(target=lambda: lifts.extend(map(str.strip, robot.stdout or ())))
            reader.start()
            for _ in range(200):
                for late_s, press_id in ((1.1, "late"), (-1.1, "early"), (0.0, "fresh")):
                    time_ns = time.time_ns() - round(late_s * 1e9)
                    said = {"state": "lift", "press_id": press_id, "time_ns": time_ns}
                    station.publish(f"{ROOT}/contact", json.dumps(said))
                if lifts:
                    break
                time.sleep(0.1)
            robot.terminate()
            reader.join(20)
        station.disconnect()
        station.loop_stop()
    assert lifts == ["lift fresh"]
