"""From the address of a broker to a verdict in programs of others, as docs/subscribers.md leads: no line of code.

Run by `make test-subscribers`, which installs them. Ours are the station and the printed descriptions alone.
"""

import json
import os
import shutil
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from ports import free_port
from real_brokers import require
from station import MQTT, press_recording, small_bundle, station_config
from waiting import wait_until

from edge.cli.describe import Format, text_at
from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.pictures.image_file import texts
from edge.store.outbox import Outbox
from plugins.sinks.sparkplug_metrics import DataType, Metric, encode

pytestmark = pytest.mark.subscribers

INSTALLED = Path(os.environ.get("GELGATE_SUBSCRIBERS", ".venv-subscribers")).absolute()
ROOT = "gelgate/site/line/station/gel/v1"
ALL = "gelgate/+/+/+/gel/v1/#"


@pytest.fixture(scope="module")
def broker() -> Iterator[LocalBroker]:
    require("mosquitto")
    with LocalBroker("mosquitto") as running:
        yield running


@pytest.fixture(scope="module")
def config(broker: LocalBroker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A station that has inspected three presses, the second one damaged, the last one sound; it is closed again."""
    folder = tmp_path_factory.mktemp("station")
    bundle = small_bundle(folder / "bundle", press_recording(folder / "nominal", 12, seed=1))
    recording = press_recording(folder / "presses", 3, dented=[1], seed=2)
    retained = "[station]\nlast_heatmap = true"
    path = station_config(folder, recording, bundle, sinks=MQTT % broker.port, tables=retained)
    loaded = load_config(path)
    with open_station(loaded, SystemClock()) as gateway:
        gateway.run(threading.Event(), 3)
        with Outbox(loaded.store.path) as outbox:
            wait_until(lambda: outbox.status().rows == 0)
    return path


def run(words: Sequence[object], given: bytes = b"", cwd: Path | None = None) -> bytes:
    """Return what a program prints that is given this. Errors: AssertionError with its complaint where it fails."""
    done = subprocess.run(list(map(str, words)), cwd=cwd, input=given, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


@pytest.fixture(scope="module")
def installed() -> Path:
    if not (INSTALLED / "node_modules" / "node-red").is_dir() or shutil.which("node") is None:
        pytest.skip(f"SKIPPED, NOT TESTED: Node-RED is not installed in {INSTALLED}")
    return INSTALLED


@pytest.fixture(scope="module")
def dashboard(
    broker: LocalBroker, config: Path, installed: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    """A Node-RED server with the flow that the broker gives; gives the address of its page."""
    started = time.monotonic()
    folder = tmp_path_factory.mktemp("node-red")
    (folder / "flows.json").write_text(text_at(address_of(broker), ALL, Format.NODE_RED), encoding="utf-8")
    port, program = free_port(), installed / "node_modules" / "node-red" / "red.js"
    words = ["node", program, "-u", folder, "-p", str(port), "flows.json"]
    with (folder / "log").open("wb") as log:
        own = os.environ | {"HOME": str(folder)}
        server = subprocess.Popen(words, stdout=log, stderr=log, cwd=folder, env=own)
    address = f"http://127.0.0.1:{port}/gelgate/site/line/station"
    try:
        wait_until(lambda: b"PASS" in get(address).upper() or server.poll() is not None)
        assert server.poll() is None, f"Node-RED has ended: {(folder / 'log').read_text()[-1000:]}"
        took_s = time.monotonic() - started
        print(f"\nfrom the address of the broker to the verdict in Node-RED: {took_s:.1f} s (budget 600 s)")
        yield address
    finally:
        server.terminate()
        server.wait(20)


def address_of(broker: LocalBroker) -> Broker:
    """All that is known."""
    return Broker(broker.host, broker.port, "newcomer")


def get(address: str) -> bytes:
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return bytes(answer.read())
    except (urllib.error.URLError, ConnectionError):
        return b""


def test_the_verdict_is_on_a_page_of_node_red(dashboard: str) -> None:
    """With part, ratio to the threshold, gel, and that the station has stopped since."""
    page = get(dashboard).decode()

    assert '<h1 class="pass">pass</h1>' in page
    assert "PZ0 pos1" in page
    assert "3 of 1000 presses" in page
    assert "offline" in page


def test_the_picture_is_that_of_the_verdict(dashboard: str) -> None:
    """With the facts inside."""
    written = texts(get(f"{dashboard}/picture"))

    assert written["verdict"] == "pass"
    assert written["part"] == "PZ0/pos1"


READ = """
const client = require("mqtt").connect("mqtt://127.0.0.1:" + process.argv[1], { protocolVersion: 5 });
const heard = {};
client.on("message", (topic, payload) => { heard[topic] = payload.toString("latin1"); });
client.subscribe("gelgate/#", () => setTimeout(() => { console.log(JSON.stringify(heard)); client.end(); }, 1000));
"""


def test_a_node_client_reads_everything_there(broker: LocalBroker, config: Path, installed: Path) -> None:
    """Nothing but the address: the document names the topics that it has just received."""
    heard = json.loads(run(["node", "-e", READ, broker.port], cwd=installed))
    document = json.loads(heard[f"{ROOT}/asyncapi"])
    addresses = {channel["address"] for channel in document["channels"].values()}

    fixed = {topic for topic in heard if "/alarm/" not in topic}
    assert fixed <= addresses
    assert {
        f"{ROOT}/{name}" for name in ("state", "availability", "last/press", "last/heatmap", "gel")
    } <= fixed
    assert json.loads(heard[f"{ROOT}/last/press"])["verdict"] == "pass"


DECODE = """
const { decodePayload } = require("sparkplug-payload").get("spBv1.0");
const { metrics, seq } = decodePayload(require("fs").readFileSync(0));
console.log(JSON.stringify({ seq: Number(seq), metrics: metrics.map(({ name, value, type, isHistorical }) => (
    { name, type, value: typeof value === "object" && value !== null ? Number(value) : value, late: !!isHistorical }
)) }));
"""


def test_a_decoder_of_others_reads_our_sparkplug_payload(installed: Path) -> None:
    """That of Eclipse Tahu, with the types of the specification."""
    if not (installed / "node_modules" / "sparkplug-payload").is_dir():
        pytest.skip(f"SKIPPED, NOT TESTED: sparkplug-payload is not installed in {installed}")
    sent = [
        Metric("n", DataType.INT64, 801, 1),
        Metric("x", DataType.DOUBLE, 2.5, 1, is_historical=True),
        Metric("b", DataType.BOOLEAN, False, 1),
        Metric("s", DataType.STRING, "Bügel", 1),
        Metric("none", DataType.STRING, None, 1),
    ]

    read = json.loads(run(["node", "-e", DECODE], cwd=installed, given=encode(sent, 1, 7)))
    assert read["seq"] == 7
    assert [(one["name"], one["value"], one["type"], one["late"]) for one in read["metrics"]] == [
        ("n", 801, "Int64", False),
        ("x", 2.5, "Double", True),
        ("b", False, "Boolean", False),
        ("s", "Bügel", "String", False),
        ("none", None, "String", False),
    ]


CHECK = """
import asyncio, importlib, json, sys
from homeassistant.components.mqtt.schemas import DEVICE_DISCOVERY_SCHEMA
from homeassistant.const import __version__
from homeassistant.core import HomeAssistant

async def check():
    hass = HomeAssistant(sys.argv[1])  # templates need one
    device = json.load(sys.stdin)
    DEVICE_DISCOVERY_SCHEMA(device)
    shared = {key: value for key, value in device.items() if key not in ("components", "origin")}
    for name, one in device["components"].items():
        platform = importlib.import_module("homeassistant.components.mqtt." + one.pop("platform"))
        platform.DISCOVERY_SCHEMA({**shared, **one})
    await hass.async_stop(force=True)
    print(__version__, len(device["components"]))

asyncio.run(check())
"""


def test_home_assistant_accepts_the_discovery(broker: LocalBroker, config: Path, tmp_path: Path) -> None:
    """By its own schemas: that of the device, and that of the platform of each entity."""
    python = INSTALLED / "home-assistant" / "bin" / "python"
    if not list((INSTALLED / "home-assistant").glob("lib/python*/site-packages/homeassistant")):
        pytest.skip(f"SKIPPED, NOT TESTED: Home Assistant is not installed at {python}")
    message = text_at(address_of(broker), ALL, Format.HOME_ASSISTANT)

    version, entities = run([python, "-c", CHECK, tmp_path], given=message.encode()).decode().split()
    assert int(entities) == len(json.loads(message)["components"])
    print(f"\naccepted by Home Assistant {version}")
