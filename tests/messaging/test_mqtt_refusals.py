"""What the MQTT sink says when a broker refuses: sizes, rules, credentials, certificates, and what is no broker."""

import contextlib
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from scripted_broker import ScriptedBroker

from edge.config import PluginTable
from edge.core.errors import ConfigError, SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.gateway.preflight import try_sink
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, read_password
from edge.messaging.mqtt_connection import _PACKET_OVERHEAD_BYTES, Connection
from plugins.sinks.mqtt import plugin
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import PATIENCE_S, ROOT, SinkTo, require, sent

# Started by root, mosquitto would read its files as another user, who may not reach the folder of a test.
AS_STARTED = "user root\n"

KEY = "ec -pkeyopt ec_paramgen_curve:prime256v1"  # made at once, where one of RSA takes seconds


@pytest.mark.parametrize(
    ("protocol", "words"), [("5", "takes packets up to"), ("3.1.1", "closed the connection 3 times")]
)
def test_too_large_is_refused_and_the_next_goes_through(sink_to: SinkTo, protocol: str, words: str) -> None:
    """Level 5 states the limit; at 3.1.1 the broker only closes the connection, and three times are proof."""
    require("mosquitto")
    with LocalBroker("mosquitto", extra="max_packet_size 2000") as broker:
        sink = sink_to(broker, protocol=protocol)
        with pytest.raises(SinkRejected, match=words):
            sent(sink, Message("heatmap/1", bytes(10_000), content_type="image/png"))
        sent(sink, Message("result", b"{}"))


@pytest.mark.parametrize(("room", "words"), [(0, None), (-1, "takes packets up to")])
def test_a_packet_is_more_than_its_payload(scripted: ScriptedBroker, room: int, words: str | None) -> None:
    """What just fits is sent; one byte more would close the connection, with others on it."""
    connection = Connection.open(Broker("127.0.0.1", scripted.port, "x", level="5", timeout_s=PATIENCE_S))
    connection._largest_packet = 50 + 100 + _PACKET_OVERHEAD_BYTES + room
    with contextlib.nullcontext() if words is None else pytest.raises(SinkRejected, match=words):
        connection.publish(Message("t" * 50, bytes(100)))
    connection.close()

    assert len(scripted.published) == (words is None)


def test_a_topic_forbidden_by_access_rules_is_a_refusal_at_level_5(sink_to: SinkTo, tmp_path: Path) -> None:
    """The sentence names the topic and the reason."""
    require("mosquitto")
    rules = tmp_path / "acl"
    rules.write_text(f"topic write {ROOT}/result\ntopic write {ROOT}/state\ntopic read #\n")
    with LocalBroker("mosquitto", extra=f"{AS_STARTED}acl_file {rules}") as broker:
        sink = sink_to(broker, protocol="5")
        sink.send(Message("result", b"{}"))
        with pytest.raises(SinkRejected, match=r"heatmap/1: Not authorized; check its access rules"):
            sink.send(Message("heatmap/1", b""))
        sink.send(Message("result", b"{}"))


def checks(broker: LocalBroker, **options: Any) -> str:
    """Return what `gelgate check` says of this broker."""
    given = {"host": broker.host, "port": broker.port, **options}
    return try_sink(PluginTable(plugin="mqtt", options=given), "sinks.0")


def test_a_check_ends_no_connection_of_the_station(sink_to: SinkTo) -> None:
    """It logs in beside the station that runs, under a client id of its own."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        sink = sink_to(broker, client_id="station")
        sink.send(Message("result", b"{}"))
        connection = sink._connection
        said = checks(broker, client_id="station")
        sink.send(Message("result", b"{}"))

        assert said == f"{broker.host}:{broker.port} lets this station in, MQTT 5"
        assert sink._connection is connection


def test_wrong_credentials_keep_the_message_and_say_so(sink_to: SinkTo, tmp_path: Path) -> None:
    """The message waits until the credentials are right. The password is in no sentence."""
    require("mosquitto")
    secret = tmp_path / "password"
    secret.write_text("s3cret\n")
    with LocalBroker("mosquitto", extra="allow_anonymous false") as broker:
        sink = sink_to(broker, username="gelgate", password_file=str(secret))
        with pytest.raises(SinkUnavailable, match=r"refuses the connection: Not authorized") as refusal:
            sink.send(Message("result", b"{}"))

        with pytest.raises(SinkRejected, match=r"Not authorized.*asked as client 'gelgate-check'") as checked:
            checks(broker, username="gelgate", password_file=str(secret))

    assert "s3cret" not in f"{refusal.value} {checked.value}"
    assert "s3cret" not in repr(sink._broker)


@pytest.fixture
def certificates(tmp_path: Path) -> Path:
    """ca, server and client keys and certificates, made here; skipped with a message where there is no openssl."""
    if shutil.which("openssl") is None:
        pytest.skip("SKIPPED, NOT TESTED: TLS needs openssl to make certificates")

    def openssl(command: str) -> None:
        subprocess.run(["openssl", *command.split()], cwd=tmp_path, check=True, capture_output=True)

    may_sign = "-addext keyUsage=critical,keyCertSign"  # else Python 3.13 refuses it
    openssl(f"req -x509 -newkey {KEY} -nodes -days 2 -subj /CN=ca {may_sign} -keyout ca.key -out ca.pem")
    (tmp_path / "names").write_text("subjectAltName=IP:127.0.0.1")
    for name in ("server", "client"):
        openssl(f"req -newkey {KEY} -nodes -subj /CN={name} -keyout {name}.key -out {name}.csr")
        signed = f"-in {name}.csr -CA ca.pem -CAkey ca.key -CAcreateserial -extfile names -out {name}.pem"
        openssl(f"x509 -req -days 2 {signed}")
    return tmp_path


def test_mutual_tls_lets_in_who_has_a_certificate_and_no_other(sink_to: SinkTo, certificates: Path) -> None:
    """With both files the message is acknowledged; without our certificate, or with a strange authority, it waits."""
    require("mosquitto")
    files = {name: str(certificates / name) for name in ("ca.pem", "client.pem", "client.key", "server.pem")}
    extra = (
        f"cafile {files['ca.pem']}\ncertfile {files['server.pem']}\nkeyfile {certificates / 'server.key'}\n"
    )
    with LocalBroker("mosquitto", extra=AS_STARTED + extra + "require_certificate true") as broker:
        ours = {"ca": files["ca.pem"], "cert": files["client.pem"], "key": files["client.key"]}
        sink_to(broker, tls=ours).send(Message("result", b"{}"))

        assert "lets this station in" in checks(broker, tls=ours)

        for others in ({"ca": files["ca.pem"]}, {**ours, "ca": files["client.pem"]}):
            assert checks(broker, tls=others).startswith("warning: broker")
            with pytest.raises(SinkUnavailable):
                sink_to(broker, tls=others, acknowledge_s=1.0).send(Message("result", b"{}"))


@contextlib.contextmanager
def false_broker(answer: bytes | None) -> Iterator[int]:
    """A port that accepts connections, and answers each first packet with fixed bytes, or not at all."""

    def serve() -> None:
        # Who asks may be gone already; the server ends.
        with contextlib.ExitStack() as held, contextlib.suppress(OSError):
            while True:
                connection = held.enter_context(server.accept()[0])
                connection.recv(1000)
                if answer is not None:
                    connection.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        serving = threading.Thread(target=serve)
        serving.start()
        try:
            yield server.getsockname()[1]
        finally:
            server.shutdown(socket.SHUT_RDWR)
            serving.join()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, r"does not answer at MQTT 5 \(it is silent\)"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "does not answer at MQTT 5"),
        (b"\x20\x02\x00\x01", "refuses the connection|does not answer"),
        (b"\x20\x02\x00\x05", "refuses the connection"),
        (b"\xff\xff\xff\xff\xff\xff", "does not answer at MQTT 5"),
    ],
    ids=["silence", "a web server", "unsupported level", "not authorized", "garbage"],
)
def test_what_is_no_broker_or_refuses_is_said_in_a_sentence(answer: bytes | None, words: str) -> None:
    """Silence, another protocol, garbage and refusals all end in SinkUnavailable, with no exception in a thread."""
    limit_s = PATIENCE_S if words == "refuses the connection" else 0.3  # for what is silent, or seems so
    with false_broker(answer) as port, pytest.raises(SinkUnavailable, match=words):
        Connection.open(Broker("127.0.0.1", port, "x", timeout_s=limit_s))


@pytest.mark.parametrize(
    "options",
    [{"hosts": "x"}, {"port": 0}, {"protocol": "4"}, {"password_file": "p"}, {"tls": {"key": "k"}}],
    ids=lambda options: next(iter(options)),
)
def test_options_refuse_nonsense(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        MqttOptions.model_validate(options)


def test_a_file_that_is_empty_absent_or_a_pipe_is_a_configuration_fault(tmp_path: Path) -> None:
    """When the sink is opened, before anything connects: without a password the broker would refuse the station, and a
    pipe would be waited for at every start."""
    empty, pipe, absent = tmp_path / "empty", tmp_path / "pipe", tmp_path / "absent"
    empty.write_text("\n")
    os.mkfifo(pipe)
    for options, words in (
        (
            {"username": "u", "password_file": empty},
            f"password file {empty} is empty; write the password into it",
        ),
        (
            {"username": "u", "password_file": pipe},
            f"file {pipe} cannot be read: .*it is a pipe, expected a file",
        ),
        ({"username": "u", "password_file": absent}, f"password file {absent} cannot be read"),
        ({"tls": {"ca": pipe}}, "cannot be used: one of them is a pipe"),
        ({"tls": {"ca": absent}}, f"TLS files {absent} cannot be used"),
    ):
        with pytest.raises(ConfigError, match=words):
            plugin.open(MqttOptions.model_validate(options), Station(ROOT, "x"))


def test_a_password_is_its_file_without_the_end_of_the_line(tmp_path: Path) -> None:
    """A blank at its end is part of it; an editor's mark at the beginning of the file is not."""
    (tmp_path / "password").write_bytes(b"\xef\xbb\xbfse cret \r\n")
    assert read_password(tmp_path / "password") == "se cret "
