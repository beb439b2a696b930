"""The MQTT sink against real brokers, at both protocol levels."""

import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import closing

import pytest
from waiting import wait_until

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message, Sink
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.messaging.mqtt_connection import Connection

from .conftest import PATIENCE_S, ROOT, Listen, SinkTo, require, sent

READY, HALTED = b'{"state":"ready"}', b'{"state":"halted"}'


def test_a_station_is_heard_and_asked(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """The birth comes first, is retained and not said twice; bytes stay as they are; a request is answered."""
    broker, protocol = any_broker
    early = listen(broker)
    sink = sink_to(broker, lambda verb, payload: verb.encode() + b":" + payload, protocol=protocol)
    for payload in (READY, HALTED, READY):
        sink.send(Message("state", payload, retain=True))
    sink.send(Message("heatmap/1", bytes(range(256)) * 100, content_type="image/png", expiry_s=60))
    early.wait_for(lambda heard: heard.payloads("heatmap/1") == [bytes(range(256)) * 100])
    early.ask("ping", b"12")
    early.wait_for(lambda heard: heard.payloads("cmd/ping/response") == [b"ping:12"])
    late = listen(broker, client_id="late")
    late.wait_for(lambda heard: heard.payloads("state") != [])

    assert early.heard[0].topic == f"{ROOT}/state"
    assert early.payloads("state") == [READY, HALTED, READY]
    assert set(late.payloads("state")) == {READY}  # amqtt may deliver a retained message twice
    assert late.heard[0].retain
    assert sink.level == ("5" if protocol == "5" else "3.1.1")
    assert isinstance(sink, Sink)


def test_no_small_message_waits_for_the_acknowledgement_of_the_one_before(mosquitto: LocalBroker) -> None:
    """The connection's socket sends at once."""
    broker = Broker("127.0.0.1", mosquitto.port, "hasty", level="5")
    with closing(Connection.open(broker)) as connection:
        opened = connection._client.socket()
        assert isinstance(opened, socket.socket)
        assert opened.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_the_will_is_published_when_the_process_dies(mosquitto: LocalBroker, listen: Listen) -> None:
    """Killed, it sends nothing: the broker publishes `lost`."""
    listener = listen(mosquitto)
    program = f"""
import time
import weakref
from collections.abc import Callable
from edge.core.ports import Message
from edge.core.sink_context import Station
from plugins.sinks.mqtt import plugin
from plugins.sinks.mqtt_options import MqttOptions
will, birth = Message("state", b"lost", retain=True), Message("state", b"ready", retain=True)
options = MqttOptions(host="127.0.0.1", port={mosquitto.port})
sink = plugin.open(options, Station({ROOT!r}, "dying", will=will, birth=lambda: [birth]))
time.sleep(600)
"""
    process = subprocess.Popen([sys.executable, "-c", program])
    try:
        listener.wait_for(lambda heard: heard.payloads("state") == [b"ready"])
    finally:
        process.kill()
        process.wait()

    listener.wait_for(lambda heard: heard.payloads("state") == [b"ready", b"lost"])


def test_a_goodbye_publishes_no_will(mosquitto: LocalBroker, sink_to: SinkTo, listen: Listen) -> None:
    """The last state stays retained, and a send after the end is refused. The best level is the default."""
    listener = listen(mosquitto)
    sink = sink_to(mosquitto)
    sink.send(Message("state", b"stopped", retain=True))
    assert sink.level == "5"
    sink.close()
    sink.close()

    listener.ask("marker", b"")
    listener.wait_for(lambda heard: heard.payloads("cmd/marker") != [])
    assert listener.payloads("state") == [READY, b"stopped"]
    with pytest.raises(SinkUnavailable):
        sink.send(Message("result", b""))


def test_a_broker_that_is_down_or_killed_is_found_again(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """Opening succeeds; sending reports the fault, and each send after the return is acknowledged."""
    broker, protocol = any_broker
    broker.stop()
    sink = sink_to(broker, protocol=protocol)
    with pytest.raises(SinkUnavailable, match=f"no broker answers at 127.0.0.1:{broker.port}"):
        sink.send(Message("result", b"1"))
    broker.start()
    for n in range(2):
        sent(sink, Message("result", b"%d" % n))
        broker.stop(signal.SIGKILL)
        with pytest.raises(SinkUnavailable):
            sink.send(Message("result", b"unsent %d" % n))
        broker.start()
    sent(sink, Message("last", b"2", retain=True))

    listen(broker).wait_for(lambda heard: heard.payloads("last") == [b"2"])


def test_what_was_given_up_is_never_sent_later(sink_to: SinkTo, listen: Listen) -> None:
    """A broker that stops answering: `send` gives up, and the library's queue is discarded with the connection.
    Checked by letting the library reconnect: its thread, and with it the message, then stays alive."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        sink = sink_to(broker, protocol="5", acknowledge_s=1.0)
        sent(sink, Message("result", b"before"))
        library = [t for t in threading.enumerate() if t.name == "paho-mqtt-client-press2"]
        assert library != []
        process = broker._process
        assert process is not None
        os.kill(process.pid, signal.SIGSTOP)
        with pytest.raises(SinkUnavailable, match="did not acknowledge"):
            sink.send(Message("result", b"given up"))
        for thread in library:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
        broker.stop(signal.SIGKILL)
        broker.start()
        listener = listen(broker, client_id="after")
        sent(sink, Message("result", b"after"))
        listener.wait_for(lambda heard: b"after" in heard.payloads("result"))

        assert listener.payloads("result") == [b"after"]


def test_a_retained_request_is_not_carried_out_nor_one_that_came_meanwhile(
    mosquitto: LocalBroker, sink_to: SinkTo
) -> None:
    """It would be done again on every connection; and what was asked of a station that was away, when it returns."""
    asked: list[str] = []
    other = Connection.open(Broker(mosquitto.host, mosquitto.port, "other"))
    other.publish(Message(f"{ROOT}/cmd/old", b"", retain=False))
    other.publish(Message(f"{ROOT}/cmd/kept", b"x", retain=True))
    arrived = threading.Event()

    def note(verb: str, payload: bytes) -> bytes:
        asked.append(verb)
        arrived.set()
        return b"{}"

    for protocol in ("5", "5", "3.1.1", "3.1.1"):
        arrived.clear()
        sink = sink_to(mosquitto, note, protocol=protocol)
        sink.send(Message("result", b""))
        other.publish(Message(f"{ROOT}/cmd/now", b"x"))
        assert arrived.wait(PATIENCE_S)
        sink.close()
        other.publish(Message(f"{ROOT}/cmd/late", b"x"))
    other.close()

    assert asked == ["now"] * 4


def test_many_threads_may_send(mosquitto: LocalBroker, sink_to: SinkTo, listen: Listen) -> None:
    """Every message of each thread arrives, in that thread's order."""
    listener = listen(mosquitto)
    sink = sink_to(mosquitto)

    def run(name: str) -> None:
        for n in range(50):
            sink.send(Message("result", f"{name}{n}".encode()))

    threads = [threading.Thread(target=run, args=(name,)) for name in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    listener.wait_for(lambda heard: len(heard.payloads("result")) == 150)
    for name in "abc":
        mine = [p for p in listener.payloads("result") if p.startswith(name.encode())]
        assert mine == [f"{name}{n}".encode() for n in range(50)]


def test_without_threads_every_attempt_is_a_step(listen: Listen, stepped: SinkTo) -> None:
    """A broker: connected, without a pause. The broker ends: a pause to wait, and a reason."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        listener = listen(broker)
        sink = stepped(broker)
        assert (sink.step(), sink.step()) == (None, None)
        sink.send(Message("result", b"1"))
        listener.wait_for(lambda heard: heard.payloads("result") == [b"1"])
    deadline = time.monotonic() + PATIENCE_S
    while (pause_s := sink.step()) is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)

    assert 0 < pause_s <= 0.2
    with pytest.raises(SinkUnavailable, match="broker"):
        sink.send(Message("result", b"2"))


def test_a_machine_that_does_not_answer_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of an answer holds for the connection to its port too."""
    limits = []

    def connect(address: object, timeout: float, **options: object) -> None:
        limits.append(timeout)
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", connect)
    with pytest.raises(SinkUnavailable, match="no broker answers"):
        Connection.open(Broker("broker.plant", 1883, "away", level="5", timeout_s=0.7))
    assert limits == [0.7]


@pytest.mark.parametrize("end", [Connection.close, lambda one: one.abandon("given up")])
def test_no_connection_leaves_a_socket(mosquitto: LocalBroker, end: Callable[[Connection], None]) -> None:
    """The library closes its own with its client: that one is gone with the connection, without the collector."""
    gc.disable()
    try:
        connection = Connection.open(
            Broker(mosquitto.host, mosquitto.port, "ends", level="5", timeout_s=60.0)
        )
        client = weakref.ref(connection._client)
        end(connection)
        del connection
        wait_until(lambda: client() is None)  # its thread ends in its own time
    finally:
        gc.enable()
