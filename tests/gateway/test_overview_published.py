"""The overview camera's stills over a real broker: on the topic that the result names, complete."""

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from station import MQTT, station_config

import edge.features.overview
from edge.clock import SystemClock
from edge.config import load_config
from edge.core.overview.codes import read_codes
from edge.gateway.gateway import Gateway
from edge.messaging.local_broker import LocalBroker, available_brokers
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection

TABLE = """
[overview]
plugin = "virtual_overview"
codes = ["apriltag"]
parts = { 17 = "PZ0" }
options = { kind = "apriltag", parts = ["17", "18", "17"] }
"""


class Heard:
    """Every message below the station, in order."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.messages: list[Received] = []

    def add(self, message: Received) -> None:
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def on(self, kind: str) -> dict[str, bytes]:
        """Topics below `gel/v1/` that begin so, with their payloads."""
        below = ((one.topic.partition("/gel/v1/")[2], one.payload) for one in self.messages)
        return {topic: payload for topic, payload in below if topic.startswith(kind)}

    def wait_for(self, is_heard: Callable[["Heard"], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: is_heard(self), 60.0), self.on("").keys()


@pytest.fixture
def mosquitto() -> Iterator[LocalBroker]:
    if "mosquitto" not in available_brokers():
        pytest.skip("SKIPPED, NOT TESTED: the broker mosquitto is not installed")
    with LocalBroker("mosquitto") as broker:
        yield broker


def test_a_subscriber_finds_the_still_of_each_result(
    tmp_path: Path, recording: Path, bundle: Path, mosquitto: LocalBroker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three presses with both threads: three stills, each with the code that its result names, refused or not."""
    # The sensor is played at full speed: on a busy machine it is faster than the thread that draws the stills.
    monkeypatch.setattr(edge.features.overview, "WAIT_S", 60.0)
    config = station_config(tmp_path, recording, bundle, sinks=MQTT % mosquitto.port)
    config.write_text(config.read_text() + TABLE)
    heard, results = Heard(), []
    listener = Connection.open(
        Broker(mosquitto.host, mosquitto.port, "listener", level="5", timeout_s=60.0),
        on_received=heard.add,
    )
    listener.subscribe("gelgate/#")
    with Gateway.open(load_config(config), SystemClock(), lambda r: results.append(r.result)) as gateway:
        gateway.run(threading.Event())
        heard.wait_for(lambda one: len(one.on("overview/")) >= 3)
        heard.wait_for(lambda one: last_still(one) == results[-1].overview_topic)
    listener.close()
    stills = heard.on("overview/")

    assert [result.part_codes for result in results] == [["17"], ["18"], ["17"]]
    assert [str(result.verdict) == "rejected" for result in results] == [False, True, False]
    assert set(stills) == {result.overview_topic for result in results}
    for result in results:
        still = cv2.imdecode(
            np.frombuffer(stills[str(result.overview_topic)], np.uint8), cv2.IMREAD_GRAYSCALE
        )
        assert [
            code.text for code in read_codes(np.asarray(still, np.uint8), ["apriltag"])
        ] == result.part_codes


def last_still(heard: Heard) -> object:
    """What the retained result names, which comes after the still."""
    last = heard.on("last").get("last")
    return last and json.loads(last)["overview_topic"]
