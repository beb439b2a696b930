"""Unexpected errors in the functions that a station gives to its sink."""

import time

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.local_broker import LocalBroker
from plugins.sinks.mqtt import plugin
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import PATIENCE_S, ROOT


def test_a_birth_that_breaks_once_does_not_keep_the_sink_down_for_ever() -> None:
    """The connection is made again; its thread continues."""
    births: list[int] = []

    def birth() -> list[Message]:
        births.append(1)
        if len(births) == 1:
            raise RuntimeError("unexpected")
        return []

    with LocalBroker() as broker:
        station = Station(ROOT, client_id="unexpected", birth=birth)
        sink = plugin.open(MqttOptions(host=broker.host, port=broker.port, retry_s=1.0), station)
        try:
            deadline = time.monotonic() + PATIENCE_S
            while True:
                try:
                    sink.send(Message("result", b"1"))
                    break
                except SinkUnavailable:
                    assert time.monotonic() < deadline
                    time.sleep(0.02)
        finally:
            sink.close()

    assert len(births) == 2
