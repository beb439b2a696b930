"""The MQTT sink against real brokers, at both protocol levels."""

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.core.backoff import Backoff
from edge.core.errors import ConfigError, SinkRejected, SinkUnavailable
from edge.core.ports import Message, Sink
from edge.core.sink_context import Station
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Outgoing
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt import MqttSink, plugin
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import ROOT, Listener, require

SinkTo = Callable[..., MqttSink]
Listen = Callable[..., Listener]


def sent(sink: MqttSink, message: Message, timeout_s: float = 20.0) -> None:
    """Send, trying again while the broker is away."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return sink.send(message)
        except SinkUnavailable:
            assert time.monotonic() < deadline
            time.sleep(0.05)


def test_a_message_arrives_with_its_bytes_at_each_level(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """Any byte, below the station's root, once acknowledged; the level is the broker's."""
    broker, protocol = any_broker
    listener = listen(broker)
    sink = sink_to(broker, protocol=protocol)

    sink.send(Message("heatmap/1", bytes(range(256)) * 100, content_type="image/png", expiry_s=60))

    listener.wait_for(lambda heard: heard.payloads("heatmap/1") != [])
    assert listener.payloads("heatmap/1") == [bytes(range(256)) * 100]
    assert sink.level == ("5" if protocol == "5" else "3.1.1")
    assert isinstance(sink, Sink)


def test_auto_speaks_level_5_where_it_can(mosquitto: LocalBroker, sink_to: SinkTo) -> None:
    """The best level is the default."""
    sink = sink_to(mosquitto)
    sink.send(Message("result", b"{}"))

    assert sink.level == "5"


def test_birth_is_heard_on_every_connection_and_before_anything_else(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """The state is `ready` first, and retained for later subscribers."""
    broker, protocol = any_broker
    early = listen(broker)
    sink = sink_to(broker, protocol=protocol)
    sink.send(Message("result", b"1"))
    early.wait_for(lambda heard: heard.payloads("result") != [])

    late = listen(broker, client_id="late")
    late.wait_for(lambda heard: heard.payloads("state") != [])

    assert [m.topic.removeprefix(f"{ROOT}/") for m in early.heard] == ["state", "result"]
    assert set(late.payloads("state")) == {b'{"state":"ready"}'}  # amqtt may deliver a retained message twice
    assert late.heard[0].retain


def test_what_the_birth_has_said_is_not_said_twice(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """The publisher has the same state to send; only another one, or the same one again later, is published."""
    broker, protocol = any_broker
    listener = listen(broker)
    sink = sink_to(broker, protocol=protocol)
    for payload in (b'{"state":"ready"}', b'{"state":"halted"}', b'{"state":"ready"}'):
        sink.send(Message("state", payload, retain=True))
    sink.send(Message("result", b"end"))
    listener.wait_for(lambda heard: heard.payloads("result") != [])

    assert listener.payloads("state") == [b'{"state":"ready"}', b'{"state":"halted"}', b'{"state":"ready"}']


def test_the_will_is_published_when_the_process_dies(
    any_broker: tuple[LocalBroker, str], listen: Listen
) -> None:
    """Killed, it sends nothing: the broker publishes `lost`."""
    broker, protocol = any_broker
    listener = listen(broker)
    program = f"""
import time
from edge.core.ports import Message
from edge.core.sink_context import Station
from plugins.sinks.mqtt import plugin
from plugins.sinks.mqtt_options import MqttOptions
will, birth = Message("state", b"lost", retain=True), Message("state", b"ready", retain=True)
options = MqttOptions(host="127.0.0.1", port={broker.port}, protocol={protocol!r})
sink = plugin.open(options, Station({ROOT!r}, "dying", will=will, birth=lambda: [birth]))
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", program])
    try:
        listener.wait_for(lambda heard: heard.payloads("state") == [b"ready"])
    finally:
        process.kill()
        process.wait()

    listener.wait_for(lambda heard: heard.payloads("state") == [b"ready", b"lost"])


def test_a_goodbye_publishes_no_will(mosquitto: LocalBroker, sink_to: SinkTo, listen: Listen) -> None:
    """The last state stays retained, and a send after the end is refused."""
    listener = listen(mosquitto)
    sink = sink_to(mosquitto)
    sink.send(Message("state", b"stopped", retain=True))
    sink.close()
    sink.close()

    probe = Connection.open(Broker(mosquitto.host, mosquitto.port, "probe"))
    probe.publish(Outgoing(f"{ROOT}/probe", b""))
    probe.close()
    listener.wait_for(lambda heard: heard.payloads("probe") != [])
    assert listener.payloads("state") == [b'{"state":"ready"}', b"stopped"]
    with pytest.raises(SinkUnavailable):
        sink.send(Message("result", b""))


def test_a_broker_that_is_down_at_start_is_normal(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """Opening succeeds; sending reports the fault, and succeeds once the broker is up."""
    broker, protocol = any_broker
    broker.stop()
    sink = sink_to(broker, protocol=protocol)
    with pytest.raises(SinkUnavailable, match=f"no broker answers at 127.0.0.1:{broker.port}"):
        sink.send(Message("result", b"1"))

    broker.start()
    sent(sink, Message("last", b"2", retain=True))

    listener = listen(broker)
    listener.wait_for(lambda heard: heard.payloads("last") == [b"2"])


def test_a_broker_that_is_killed_and_returns_is_found_again(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo
) -> None:
    """Three times over, each send after the return is acknowledged."""
    broker, protocol = any_broker
    sink = sink_to(broker, protocol=protocol)
    for n in range(3):
        sent(sink, Message("result", b"%d" % n))
        broker.kill()
        with pytest.raises(SinkUnavailable):
            sink.send(Message("result", b"unsent %d" % n))
        broker.start()
    sent(sink, Message("result", b"end"))


def test_what_was_given_up_is_never_sent_later(tmp_path: Path, sink_to: SinkTo, listen: Listen) -> None:
    """A broker that stops answering: `send` gives up, and the library's queue is discarded with the connection.

    Checked by letting the library reconnect: its thread, and with it the message, then stays alive.
    """
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        sink = sink_to(broker, acknowledge_s=0.5)
        sink.send(Message("result", b"before"))
        (library,) = [t for t in threading.enumerate() if t.name == "paho-mqtt-client-press2"]
        process = broker._process
        assert process is not None
        os.kill(process.pid, signal.SIGSTOP)
        with pytest.raises(SinkUnavailable, match="did not acknowledge"):
            sink.send(Message("result", b"given up"))
        library.join(10)
        assert not library.is_alive()
        broker.kill()
        broker.start()
        listener = listen(broker, client_id="after")
        sent(sink, Message("result", b"after"))
        listener.wait_for(lambda heard: b"after" in heard.payloads("result"))

        assert listener.payloads("result") == [b"after"]


@pytest.mark.parametrize(
    ("protocol", "words"), [("5", "takes packets up to"), ("3.1.1", "closed the connection 3 times")]
)
def test_a_message_that_is_too_large_is_refused_and_the_next_goes_through(
    sink_to: SinkTo, protocol: str, words: str
) -> None:
    """Level 5 states the limit; at 3.1.1 the broker only closes the connection, and three times are proof."""
    require("mosquitto")
    with LocalBroker("mosquitto", extra="max_packet_size 2000") as broker:
        sink = sink_to(broker, protocol=protocol)
        with pytest.raises(SinkRejected, match=words):
            sent(sink, Message("heatmap/1", bytes(10_000), content_type="image/png"))
        sent(sink, Message("result", b"{}"))


def test_a_topic_forbidden_by_access_rules_is_a_refusal_at_level_5(sink_to: SinkTo, tmp_path: Path) -> None:
    """The sentence names the topic and the reason."""
    require("mosquitto")
    rules = tmp_path / "acl"
    rules.write_text(f"topic write {ROOT}/result\ntopic write {ROOT}/state\ntopic read #\n")
    for path in (tmp_path, *tmp_path.parents[:3], rules):
        path.chmod(path.stat().st_mode | 0o055)
    with LocalBroker("mosquitto", extra=f"acl_file {rules}") as broker:
        sink = sink_to(broker, protocol="5")
        sink.send(Message("result", b"{}"))
        with pytest.raises(SinkRejected, match=r"heatmap/1: Not authorized; check its access rules"):
            sink.send(Message("heatmap/1", b""))
        sink.send(Message("result", b"{}"))


def test_wrong_credentials_keep_the_message_and_say_so(sink_to: SinkTo, tmp_path: Path) -> None:
    """The message waits until the credentials are right. The password is in no sentence."""
    require("mosquitto")
    secret = tmp_path / "password"
    secret.write_text("s3cret\n")
    with LocalBroker("mosquitto", extra="allow_anonymous false") as broker:
        sink = sink_to(broker, username="gelgate", password_file=str(secret))
        with pytest.raises(SinkUnavailable, match=r"refuses the connection: Not authorized") as refusal:
            sink.send(Message("result", b"{}"))

    assert "s3cret" not in str(refusal.value)
    assert "s3cret" not in repr(sink._broker)


@pytest.fixture
def certificates(tmp_path: Path) -> Path:
    """ca, server and client keys and certificates, made here; skipped with a message where there is no openssl."""
    if shutil.which("openssl") is None:
        pytest.skip("SKIPPED, NOT TESTED: TLS needs openssl to make certificates")

    def openssl(command: str) -> None:
        subprocess.run(["openssl", *command.split()], cwd=tmp_path, check=True, capture_output=True)

    openssl("req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=ca -keyout ca.key -out ca.pem")
    (tmp_path / "names").write_text("subjectAltName=IP:127.0.0.1")
    for name in ("server", "client"):
        openssl(f"req -newkey rsa:2048 -nodes -subj /CN={name} -keyout {name}.key -out {name}.csr")
        signed = f"-in {name}.csr -CA ca.pem -CAkey ca.key -CAcreateserial -extfile names -out {name}.pem"
        openssl(f"x509 -req -days 2 {signed}")
    for path in (*tmp_path.iterdir(), tmp_path, *tmp_path.parents[:3]):
        path.chmod(path.stat().st_mode | 0o055)  # mosquitto started by root reads them as its own user
    return tmp_path


# The library leaves the socket of a failed handshake to the garbage collector.
@pytest.mark.filterwarnings("ignore:.*ssl.SSLSocket.*:pytest.PytestUnraisableExceptionWarning")
def test_mutual_tls_lets_in_who_has_a_certificate_and_nobody_else(
    sink_to: SinkTo, certificates: Path
) -> None:
    """With both files the message is acknowledged; without our certificate, or with a strange authority, it waits."""
    require("mosquitto")
    files = {name: str(certificates / name) for name in ("ca.pem", "client.pem", "client.key", "server.pem")}
    extra = (
        f"cafile {files['ca.pem']}\ncertfile {files['server.pem']}\nkeyfile {certificates / 'server.key'}\n"
    )
    with LocalBroker("mosquitto", extra=extra + "require_certificate true") as broker:
        ours = {"ca": files["ca.pem"], "cert": files["client.pem"], "key": files["client.key"]}
        sink_to(broker, tls=ours).send(Message("result", b"{}"))

        for others in ({"ca": files["ca.pem"]}, {**ours, "ca": files["client.pem"]}):
            with pytest.raises(SinkUnavailable):
                sink_to(broker, tls=others, acknowledge_s=1.0).send(Message("result", b"{}"))


def test_requests_are_answered_at_each_level(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """The verb and the payload reach the station; its answer arrives on the response topic."""
    broker, protocol = any_broker
    sink = sink_to(broker, lambda verb, payload: verb.encode() + b":" + payload, protocol=protocol)
    sink.send(Message("result", b""))
    listener = listen(broker)

    listener.ask("ping", b"12")

    listener.wait_for(lambda heard: heard.payloads("cmd/ping/response") == [b"ping:12"])


def test_a_retained_request_is_not_carried_out(mosquitto: LocalBroker, sink_to: SinkTo) -> None:
    """It would be done again on every connection."""
    asked: list[str] = []
    other = Connection.open(Broker(mosquitto.host, mosquitto.port, "other"))
    other.publish(Outgoing(f"{ROOT}/cmd/old", b"", retain=False))
    other.publish(Outgoing(f"{ROOT}/cmd/kept", b"x", retain=True))
    arrived = threading.Event()

    def note(verb: str, payload: bytes) -> bytes:
        asked.append(verb)
        arrived.set()
        return b"{}"

    for protocol in ("5", "3.1.1"):
        arrived.clear()
        sink = sink_to(mosquitto, note, protocol=protocol)
        sink.send(Message("result", b""))
        other.publish(Outgoing(f"{ROOT}/cmd/now", b"x"))
        assert arrived.wait(20)
        sink.close()
    other.close()

    assert asked == ["now", "now"]


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


class FalseBroker:
    """Accepts connections and answers each first packet with fixed bytes, or not at all."""

    def __init__(self, answer: bytes | None) -> None:
        self._answer = answer
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._held: list[socket.socket] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self._held.append(connection)
            connection.recv(1000)
            if self._answer is not None:
                connection.sendall(self._answer)

    def close(self) -> None:
        self._server.close()
        for connection in self._held:
            connection.close()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "does not answer at MQTT 5"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "does not answer at MQTT 5"),
        (b"\x20\x02\x00\x01", "refuses the connection|does not answer"),
        (b"\x20\x02\x00\x05", "refuses the connection"),
        (b"\xff\xff\xff\xff\xff\xff", "does not answer at MQTT 5"),
    ],
    ids=["silence", "a web server", "unsupported level", "not authorized", "garbage"],
)
def test_what_is_no_broker_or_refuses_is_said_in_a_sentence(answer: bytes | None, words: str) -> None:
    """Silence, another protocol, garbage and refusals all end in SinkUnavailable, with no exception in a thread."""
    false = FalseBroker(answer)
    try:
        with pytest.raises(SinkUnavailable, match=words):
            Connection.open(Broker("127.0.0.1", false.port, "x", timeout_s=0.3))
    finally:
        false.close()


@pytest.mark.parametrize(
    "options",
    [
        {"hosts": "x"},
        {"port": 0},
        {"protocol": "4"},
        {"password_file": "p"},
        {"tls": {"key": "k"}},
    ],
    ids=lambda options: next(iter(options)),
)
def test_options_refuse_nonsense(options: dict[str, Any]) -> None:
    """Unknown keys, impossible ports, a password without a name, a key without its certificate."""
    with pytest.raises(ValueError, match="validation error"):
        MqttOptions.model_validate(options)


def test_a_file_that_is_not_there_is_a_configuration_fault(sink_to: SinkTo) -> None:
    """Password and TLS files are read when the sink is opened, before anything connects."""
    from edge.core.sink_context import Station

    station = Station(ROOT, "x")
    with pytest.raises(ConfigError, match="password file /nowhere/p cannot be read"):
        plugin.open(MqttOptions(username="u", password_file=Path("/nowhere/p")), station)
    with pytest.raises(ConfigError, match=r"TLS files /nowhere/ca\.pem cannot be used"):
        plugin.open(MqttOptions.model_validate({"tls": {"ca": "/nowhere/ca.pem"}}), station)


def test_without_threads_every_attempt_is_a_step(listen: Listen) -> None:
    """A broker: connected, without a pause. The broker ends: a pause to wait, and a reason."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        listener = listen(broker)
        options = MqttOptions(host=broker.host, port=broker.port, protocol="5")
        sink = MqttSink(
            options.broker("stepped"), Station(ROOT, "stepped"), Backoff(random.Random(0), 0.2, 30.0)
        )
        assert sink.step() is None
        assert sink.step() is None
        sink.send(Message("result", b"1"))
        listener.wait_for(lambda heard: heard.payloads("result") == [b"1"])
    deadline = time.monotonic() + 20
    while (pause_s := sink.step()) is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)

    assert 0 < pause_s <= 0.2
    with pytest.raises(SinkUnavailable, match="broker"):
        sink.send(Message("result", b"2"))
    sink.close()
