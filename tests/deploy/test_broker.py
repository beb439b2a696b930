"""The shipped broker: mosquitto with the rules and certificates of `deploy/`, as a plant would start it."""

import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from ports import free_port

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.topics import TOPICS
from plugins.sinks import mqtt
from plugins.sinks.mqtt_options import MqttOptions

DEPLOY = Path(__file__).parents[2] / "deploy"
PATIENCE_S = 60.0  # far more than a busy machine needs
ROOT = "gelgate/plant/line1/station1/gel/v1"
MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
pytestmark = pytest.mark.skipif(
    MOSQUITTO is None or shutil.which("openssl") is None,
    reason="SKIPPED, NOT TESTED: the shipped broker needs mosquitto and openssl",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder `/mosquitto` of the container, with certificates made by the shipped script."""
    made = tmp_path_factory.mktemp("mosquitto")
    shutil.copytree(DEPLOY / "mosquitto", made / "config")
    (made / "data").mkdir()
    names = ("localhost", "station1", "dashboard", "supervisor", "stranger")
    subprocess.run([DEPLOY / "make_certificates.sh", made / "certificates", *names], check=True)
    return made


@pytest.fixture(scope="module")
def port(folder: Path) -> Iterator[int]:
    """The broker with the shipped configuration; only its folder and its port are others."""
    number = free_port()
    shipped = (DEPLOY / "mosquitto" / "mosquitto.conf").read_text(encoding="utf-8")
    config = folder / "used.conf"
    text = shipped.replace("/mosquitto/", f"{folder}/").replace(
        "listener 8883", f"listener {number} 127.0.0.1"
    )
    config.write_text(f"{text}user root\n", encoding="utf-8")
    with (folder / "log").open("wb") as log:
        broker = subprocess.Popen([str(MOSQUITTO), "-c", config], stdout=log, stderr=log)
        try:
            await_port(number, folder / "log")
            yield number
        finally:
            broker.terminate()
            broker.wait(PATIENCE_S)


def await_port(port: int, log: Path) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.02)
    pytest.fail(f"the broker does not start: {log.read_text()}")


def sink(folder: Path, port: int, name: str | None, root: str = ROOT) -> mqtt.MqttSink:
    """A sink of this client; without a name it has no certificate."""
    files = folder / "certificates"
    tls = {"ca": str(files / "ca.crt")}
    if name is not None:
        tls |= {"cert": str(files / f"{name}.crt"), "key": str(files / f"{name}.key")}
    options = {"host": "localhost", "port": port, "protocol": "5", "tls": tls, "acknowledge_s": PATIENCE_S}
    return mqtt.plugin.open(MqttOptions.model_validate(options), Station(root, f"gelgate-{name}"))


def send(folder: Path, port: int, name: str | None, topic: str, root: str = ROOT) -> None:
    """Connect as this client, publish, leave. Errors: SinkRejected where a rule denies it."""
    one = sink(folder, port, name, root)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                one.send(Message(topic, b"{}", qos=1))
                return
            except SinkUnavailable:  # still connecting
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)
    finally:
        one.close()


def test_a_station_may_publish_its_own_topics_and_a_supervisor_may_ask(folder: Path, port: int) -> None:
    """Every topic that the program has, as docs/mqtt.md lists them; requests to any station of the plant."""
    for topic in [topic for topic, *_ in TOPICS if topic != "cmd/<verb>"]:
        filled = topic.replace("<press id>", "01ARZ3").replace("<alarm>", "disk").replace("<verb>", "trigger")
        send(folder, port, "station1", filled)
    send(folder, port, "supervisor", "cmd/trigger")


@pytest.mark.parametrize(
    ("name", "root", "topic"),
    [
        ("station1", ROOT.replace("station1", "station2"), "result"),
        ("station1", ROOT, "cmd/trigger"),
        ("station1", "$SYS/broker", "load"),
        ("dashboard", ROOT, "cmd/trigger"),
        ("dashboard", ROOT, "result"),
        ("supervisor", ROOT, "result"),
        ("stranger", ROOT, "result"),
    ],
)
def test_no_one_may_more(folder: Path, port: int, name: str, root: str, topic: str) -> None:
    """Another station's topics, requests to itself, and results by those who only read."""
    with pytest.raises(SinkRejected, match=r"Not authorized|not valid|invalid"):
        send(folder, port, name, topic, root)


# A CONNECT of MQTT 5 with client id `abc`. Ref: MQTT 5.0, 3.1.
CONNECT = b"\x10\x10\x00\x04MQTT\x05\x02\x00\x3c\x00\x00\x03abc"
CONNACK = 0x20


def answer(folder: Path, port: int, name: str | None) -> bytes:
    """The first byte of the broker to a client with this certificate, or none; empty where it refuses."""
    files = folder / "certificates"
    context = ssl.create_default_context(cafile=files / "ca.crt")
    if name is not None:
        context.load_cert_chain(files / f"{name}.crt", files / f"{name}.key")
    try:
        with (
            socket.create_connection(("localhost", port), timeout=PATIENCE_S) as plain,
            context.wrap_socket(plain, server_hostname="localhost") as secured,
        ):
            secured.sendall(CONNECT)
            return secured.recv(1)
    except (ssl.SSLError, ConnectionError):
        return b""


def test_a_client_without_a_certificate_is_refused(folder: Path, port: int) -> None:
    """Also one that trusts the plant's authority; with a certificate the same client is accepted."""
    assert answer(folder, port, None) == b""
    assert answer(folder, port, "dashboard") == bytes([CONNACK])


def test_certificates_that_are_there_are_kept(folder: Path) -> None:
    """A new client is added without new certificates for all others; private keys are for their owner alone."""
    files = folder / "certificates"
    before = {path.name: path.read_bytes() for path in files.glob("*.crt")}
    subprocess.run([DEPLOY / "make_certificates.sh", files, "localhost", "station1", "added"], check=True)
    after = {path.name: path.read_bytes() for path in files.glob("*.crt")}

    assert set(after) - set(before) == {"added.crt"}
    assert {name: after[name] for name in before} == before
    assert {path.stat().st_mode & 0o077 for path in files.glob("*.key")} == {0}
