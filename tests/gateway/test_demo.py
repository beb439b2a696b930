"""The demonstration's wiring: its station runs, over a broker, to its subscriber."""

import json
from pathlib import Path

import pytest
from station import Motion, press_recording

from calibration.demo import ROOT, _await, _inspect, _subscriber
from edge.core.errors import PressesMissed
from edge.core.ports import Message
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.messaging.mqtt_connection import Connection
from edge.store.press_store import Store


@pytest.mark.parametrize("hold", [10, 0])
def test_the_demo_inspects_over_a_broker(
    tmp_path: Path,
    recording: Path,
    bundle: Path,
    hold: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every press is printed, arrives at the subscriber with its heatmap, and is in the ledger. Presses that are too
    short to be seen are a fault: nothing inspected is not "done". So is a ledger that has no gel, as on a full disk."""
    if not hold:
        monkeypatch.setattr(Store, "gels", lambda _: [])
        recording = press_recording(tmp_path / "short", 2, motion=Motion(hold=0), seed=4)
    heatmaps = tmp_path / "heatmaps"
    heatmaps.mkdir()
    with LocalBroker() as broker:
        tally = _inspect(tmp_path, bundle, recording, heatmaps, broker)
    if not hold:
        with pytest.raises(PressesMissed, match="it holds 2 presses and the run saw 0"):
            tally.check(recording)
        return
    tally.check(recording)
    tally.show(heatmaps)
    said = capsys.readouterr().out

    assert tally.verdicts == ["pass", "fail", "pass"]
    assert [path.stem for path in sorted(heatmaps.iterdir())] == ["01-pass", "02-fail", "03-pass"]
    assert "3 of 1000 presses, good" in said
    assert "3 results over MQTT" in said
    assert "picture:    " in said
    assert "02-fail" in said.rpartition("picture:")[2]


def test_pictures_that_follow_several_results_keep_their_numbers(tmp_path: Path) -> None:
    """The subscriber has a press when its picture is there: last/press comes before it. One without has none."""
    presses = ("a", "pass"), ("b", "pass"), ("c", "error")
    results = [
        json.dumps(
            {"press_id": name, "verdict": word, "heatmap_topic": None if name == "c" else "its"}
        ).encode()
        for name, word in presses
    ]
    with LocalBroker() as broker, _subscriber(broker, tmp_path) as (received, complete):
        sender = Connection.open(Broker(broker.host, broker.port, "sender", level=broker.level))

        def say(topic: str, payload: bytes) -> None:
            sender.publish(Message(f"{ROOT}/{topic}", payload, qos=1))

        for result in results:
            say("result", result)
            say("last/press", result)
        _await(lambda: len(received) == 3)
        assert complete == {"c"}
        for name in "ab":
            say(f"heatmap/{name}", b"\xff\xd8" + name.encode())
        _await(lambda: len(complete) == 3)
        sender.close()

    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "01-pass.jpg": b"\xff\xd8a",
        "02-pass.jpg": b"\xff\xd8b",
    }
