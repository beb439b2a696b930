"""`gelgate describe`: each format from a configuration alone, as the running station describes itself."""

import json
from pathlib import Path

import pytest

from edge.cli.describe import Format, describe, described_text
from edge.config import load_config
from edge.core.errors import ConfigError

CONFIG = """
version = 1
[station]
site = "plant"
station = "press2"
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
    return described_text(load_config(config), Format(form))


def test_neither_bundle_nor_sensor_nor_broker_is_needed(config: Path) -> None:
    """All that it names may be missing: every format is printed."""
    for form in Format:
        assert text(config, form).endswith("\n")


def test_asyncapi_has_the_commands_that_are_served(config: Path) -> None:
    """Signed ones say so; others have no channel."""
    channels = json.loads(text(config, "asyncapi"))["channels"]

    assert {name for name in channels if name.startswith("cmd_")} == {
        "cmd_trigger",
        "cmd_relearn",
        "cmd_response",
    }
    assert channels["cmd_relearn"]["description"].endswith("Only with a signature.")


def test_the_rules_name_the_station_as_its_broker_knows_it(config: Path) -> None:
    """By its user name; with the topics of Home Assistant and Sparkplug, because it has such sinks."""
    lines = text(config, "mosquitto").splitlines()

    assert "user touch2" in lines
    assert "topic read spBv1.0/cell7/NCMD/line-press2" in lines
    assert "topic write ha/device/gelgate_plant_line_press2_gel_v1/config" in lines


def test_the_flow_connects_to_the_configured_broker(config: Path) -> None:
    """With TLS, at its usual port."""
    broker = json.loads(text(config, "node-red"))[1]

    assert (broker["broker"], broker["port"], broker["usetls"]) == ("broker.plant", "8883", True)


def test_a_station_without_a_broker_is_described_too(tmp_path: Path) -> None:
    """With the station's own name, and the usual broker on this machine."""
    path = tmp_path / "gelgate.toml"
    path.write_text(CONFIG.rpartition("[[sinks]]")[0], encoding="utf-8")

    assert "user press2" in text(path, "mosquitto").splitlines()
    assert json.loads(text(path, "node-red"))[1]["broker"] == "localhost"


def test_it_is_printed_or_written(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same text either way."""
    describe(config, Format.HOME_ASSISTANT)
    describe(config, Format.HOME_ASSISTANT, tmp_path / "device.json")

    printed = capsys.readouterr().out
    assert printed == (tmp_path / "device.json").read_text(encoding="utf-8")
    assert json.loads(printed)["device"]["name"] == "plant/line/press2"


def test_a_missing_configuration_is_a_refusal(tmp_path: Path) -> None:
    """One sentence with the file."""
    with pytest.raises(ConfigError, match=r"gone\.toml"):
        describe(tmp_path / "gone.toml")
