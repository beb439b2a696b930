"""One station with several receivers: at a broker as itself and as a Sparkplug node, and on a page without a broker."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from page_messages import asked
from paho.mqtt.enums import CallbackAPIVersion
from ports import free_port
from station import MQTT, station_config

from edge.clock import SystemClock
from edge.config import Config, load_config
from edge.gateway.gateway import Gateway
from edge.messaging.local_broker import LocalBroker, available_brokers
from edge.store.outbox import Outbox
from plugins.sinks.sparkplug_metrics import decode

SPARKPLUG = MQTT.replace('"mqtt"', '"sparkplug"')


class Heard:
    """What arrives at the broker, until the wanted topics have come."""

    def __init__(self, port: int) -> None:
        self.messages: list[tuple[str, bytes]] = []
        self._changed = threading.Condition()
        self._is_ready = threading.Event()
        self.client = paho.Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = self._note
        self.client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self.client.on_subscribe = lambda *_: self._is_ready.set()
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        assert self._is_ready.wait(60)

    def _note(self, client: object, data: object, message: Any) -> None:
        with self._changed:
            self.messages.append((message.topic, bytes(message.payload)))
            self._changed.notify_all()

    def verdicts(self, level: str) -> list[object]:
        metrics = [dict(decode(payload)) for topic, payload in self.messages if f"/{level}/" in topic]
        return [one["Press/Verdict"] for one in metrics if "Press/Verdict" in one]

    def results(self) -> int:
        return sum(topic.endswith("/gel/v1/result") for topic, _ in self.messages)

    def wait_for_presses(self, n: int) -> None:
        """At both receivers."""
        with self._changed:
            assert self._changed.wait_for(lambda: min(len(self.verdicts("NDATA")), self.results()) >= n, 60)


def test_each_result_is_at_both(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Three results as JSON and three as metrics, in order, and nothing is left to send."""
    if not available_brokers():
        pytest.skip("SKIPPED, NOT TESTED: no broker is installed")
    with LocalBroker() as broker:
        heard = Heard(broker.port)
        config = station_config(
            tmp_path, recording, bundle, sinks=(MQTT + SPARKPLUG) % (broker.port, broker.port)
        )
        loaded = load_config(config)
        with Gateway.open(loaded, SystemClock()) as gateway:
            gateway.run(threading.Event(), presses=3)
            heard.wait_for_presses(3)
            until(lambda: unsent(loaded) == 0)
        heard.client.disconnect()
        heard.client.loop_stop()

    assert heard.verdicts("NDATA") == ["pass", "fail", "pass"]
    assert heard.verdicts("NBIRTH") == [None]
    assert heard.results() == 3
    assert unsent(loaded) == 0


def unsent(loaded: Config) -> int:
    with Outbox(loaded.store.path) as outbox:
        return outbox.status().rows


def until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.05)


def test_the_page_goes_on_without_a_broker(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Three verdicts and their pictures, while the results wait for the broker; the page says that it is away."""
    port = free_port()
    page = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port} }}\n'
    config = station_config(tmp_path, recording, bundle, sinks=MQTT % 1 + page)
    loaded = load_config(config)

    with Gateway.open(loaded, SystemClock()) as gateway:
        gateway.run(threading.Event(), presses=3)
        until(lambda: [one["has_picture"] for one in asked(port, "/presses.json")] == [True] * 3)
        until(
            lambda: (asked(port, "/station.json")["gel"] or {}).get("presses") == 3
        )  # the last of a press's messages
        presses, station = asked(port, "/presses.json"), asked(port, "/station.json")

    assert [one["verdict"] for one in presses] == ["pass", "fail", "pass"]
    assert station["info"]["part"] == "PZ0"
    with Outbox(loaded.store.path) as outbox:
        assert sum(row.message.topic == "result" for row in outbox.pending("mqtt:127.0.0.1:1", 99)) == 3
