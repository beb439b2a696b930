"""`gelgate station describe`: each format from a configuration alone, as the running station describes itself."""

import json
from pathlib import Path

import pytest

from edge.cli.describe import Format, describe, describe_config
from edge.config import load_config
from edge.core.errors import ConfigError
from edge.core.ports import Message
from edge.gateway.command_table import describe_station
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.messaging.subscriber import Inbox, next_message

CONFIG = """
version = 1
[station]
site = "plant"
station = "press2"
heatmap = "png"
[device]
plugin = "usb_mock"
options = { recording = "none" }
[inspection]
bundle = "none"
[commands]
signed = ["relearn"]
secret_file = "none"
[[sinks]]
plugin = "jsonl"
options = { folder = "out" }
[[sinks]]
plugin = "sparkplug"
options = { group = "cell7" }
[[sinks]]
plugin = "mqtt"
options = { host = "broker.plant", tls = {}, username = "touch2", password_file = "none", home_assistant = "ha" }
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "gelgate.toml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def text(config: Path, form: str) -> str:
    return describe_config(load_config(config), Format(form))


def test_each_format_is_of_the_configured_station(config: Path) -> None:
    """All that it names may be missing. Served and signed commands, user names, topics of its sinks, its broker."""
    for form in set(Format) - {Format.CYCLONEDX}:  # which reads the bundles
        assert text(config, form).endswith("\n")
    channels = json.loads(text(config, "asyncapi"))["channels"]
    served = {name for name in channels if name.startswith("cmd_")}
    assert served == {"cmd_trigger", "cmd_relearn", "cmd_response"}
    assert channels["cmd_relearn"]["description"].endswith("Only with a signature.")
    assert {
        "user touch2",
        "topic read spBv1.0/cell7/NCMD/line-press2",
        "topic write ha/device/gelgate_plant_line_press2_gel_v1/config",
    } <= set(text(config, "mosquitto").splitlines())
    broker = json.loads(text(config, "node-red"))[1]
    assert (broker["broker"], broker["port"], broker["usetls"]) == ("broker.plant", "8883", True)


def test_a_station_without_a_broker_is_described_too(tmp_path: Path) -> None:
    """With the station's own name, and the usual broker on this machine."""
    path = tmp_path / "gelgate.toml"
    path.write_text(CONFIG.rpartition("[[sinks]]")[0], encoding="utf-8")

    assert "user press2" in text(path, "mosquitto").splitlines()
    assert json.loads(text(path, "node-red"))[1]["broker"] == "localhost"


def test_a_picture_that_is_not_taken_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By a station that retains none: the device has no picture, and the sentence says how it gets one."""
    path = tmp_path / "gelgate.toml"
    path.write_text(CONFIG.replace(', home_assistant = "ha"', ""), encoding="utf-8")

    assert "picture" not in json.loads(text(path, "homeassistant"))["components"]
    assert "set station.last_heatmap = true" in capsys.readouterr().err


def test_it_is_printed_or_written(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    describe(config, Format.HOME_ASSISTANT)
    describe(config, Format.HOME_ASSISTANT, tmp_path / "device.json")

    printed = capsys.readouterr().out
    assert printed == (tmp_path / "device.json").read_text(encoding="utf-8")
    assert json.loads(printed)["device"]["name"] == "plant/line/press2"


def hear(patch: pytest.MonkeyPatch, count: int) -> None:
    """Have the verb wait for so many messages, however long, in place of two seconds for any."""
    left = count

    def next_of(inbox: Inbox, timeout_s: float) -> Received | None:
        nonlocal left
        left -= 1
        return next_message(inbox, 60.0) if left >= 0 else None

    patch.setattr("edge.cli.describe.next_message", next_of)


def leaves(broker: LocalBroker, root: str, payload: bytes) -> None:
    """A client leaves this as the description of a station."""
    connection = Connection.open(Broker(broker.host, broker.port, "leaves", level="5", timeout_s=60.0))
    connection.publish(Message(f"{root}/asyncapi", payload, 1, retain=True))
    connection.close()


def test_the_address_of_the_broker_is_enough(
    config: Path, mosquitto: LocalBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same files as from the configuration of the station, with the broker that was named."""
    address = f'host = "{mosquitto.host}", port = {mosquitto.port}, '
    config.write_text(CONFIG.replace('host = "broker.plant", tls = {}, ', address), encoding="utf-8")
    station = describe_station(load_config(config))
    leaves(mosquitto, station.root, asyncapi_message(station).payload)
    leaves(mosquitto, station.root.replace("press2", "press3"), b"{")

    for form in ("asyncapi", "homeassistant", "node-red"):
        hear(monkeypatch, 2)
        describe(form=Format(form), host=mosquitto.host, port=mosquitto.port, output=tmp_path / form)
        assert (tmp_path / form).read_text(encoding="utf-8") == text(config, form)


def test_a_broker_without_one_station_is_refused_in_a_sentence(
    config: Path, mosquitto: LocalBroker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None, or several: then their names."""
    station = describe_station(load_config(config))
    with pytest.raises(ConfigError, match="has no station that describes itself below gelgate/\\+"):
        describe(host=mosquitto.host, port=mosquitto.port)
    for name in ("press2", "press3"):
        leaves(mosquitto, station.root.replace("press2", name), asyncapi_message(station).payload)
    hear(monkeypatch, 2)
    with pytest.raises(
        ConfigError, match="has several stations: plant/line/press2, plant/line/press3; name one"
    ):
        describe(host=mosquitto.host, port=mosquitto.port)
    with pytest.raises(ConfigError, match="give the station's --config"):
        describe(host=mosquitto.host, port=mosquitto.port, form=Format.MOSQUITTO)
