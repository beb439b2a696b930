"""The configuration: what is accepted, and how every fault is told."""

import codecs
import json
from pathlib import Path

import pytest

from edge.cli.run import example
from edge.config import load_config
from edge.config.loading import read_secret
from edge.core.digital_io import VERDICTS
from edge.core.errors import ConfigError
from edge.messaging.mqtt_broker import read_password

SOUND = """
version = 1
[station]
site = "plant"
line = "l1"
[device]
plugin = "recorded"
options = { recording = "presses" }
[inspection]
bundle = "bundles/pz1"
[[sinks]]
plugin = "jsonl"
options = { folder = "out" }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "gelgate.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(written(folder, text))
    return str(caught.value)


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    """A configuration can be moved with the files it names."""
    config = load_config(written(tmp_path, SOUND))

    assert config.inspection.bundle == tmp_path / "bundles/pz1"
    assert config.store.path == tmp_path / "gelgate.db"
    assert config.device.options["recording"] == str(tmp_path / "presses")
    assert config.sinks[0].options["folder"] == str(tmp_path / "out")
    sink = '[[sinks]]\nplugin = "mqtt"\noptions = { host = "broker", tls = { ca = "ca.pem" } }\n'
    several = load_config(
        written(tmp_path, with_bundle('bundles = [{ path = "a", names = ["4711"] }]') + sink)
    )
    assert several.sinks[1].options["tls"]["ca"] == str(tmp_path / "ca.pem")
    assert [one.path for one in several.inspection.bundles] == [tmp_path / "a"]


def test_defaults_stand_in_one_place(tmp_path: Path) -> None:
    config = load_config(written(tmp_path, SOUND))

    assert (config.gel.limit_presses, config.gel.warn_fraction) == (1000, 0.8)
    assert (config.station.prefix, config.station.station) == ("gelgate", "station")


def test_every_fault_is_told_at_once(tmp_path: Path) -> None:
    """Three faults, one report: the operator mends the file once."""
    text = SOUND.replace('site = "plant"', 'site = "plant one"').replace("version = 1", "version = 2")
    message = refusal(tmp_path, text + "[gel]\nlimit_presses = 0\n")

    assert "has 3 fault(s)" in message
    assert all(key in message for key in ("'version'", "'station.site'", "'gel.limit_presses'"))


def test_plugin_options_are_in_the_same_report(tmp_path: Path) -> None:
    """A fault in a plugin's own table does not wait for the first start."""
    message = refusal(
        tmp_path, SOUND.replace("recording =", "recordng =").replace('line = "l1"', 'lime = "l1"')
    )

    assert "'device.options.recordng' is not known; did you mean 'recording'?" in message
    assert "'station.lime' is not known; did you mean 'line'?" in message


def with_bundle(line: str) -> str:
    return SOUND.replace('bundle = "bundles/pz1"', line)


LEVELS = ("", "two words", "a/b", "a+", "#", "$SYS", "x" * 65, "\x1f", "null\x00")
STORES = (
    "outbox_days = 200000", "outbox_days = inf", "outbox_days = nan", "outbox_days = 1e300", "outbox_mb = inf",
    "outbox_mb = 1e-9", 'path = ":memory:"', 'path = ""', 'path = "file:x?mode=memory"',
)  # fmt: skip
BROKERS = (
    "acknowledge_s = inf", "acknowledge_s = 1e12", "acknowledge_s = 1e-9", "retry_s = inf",
    'client_id = "a\\u0000b"', 'username = "a\\u0007"', 'host = "a\\u001b[2J"',
)  # fmt: skip
REFUSED = [
    ("version = ", "cannot be read"),
    ("", "'version' is missing"),
    (SOUND.split("[[sinks]]")[0], "'sinks' is missing"),
    (SOUND + "[gel]\nlimit_preses = 5\n", "'gel.limit_preses' is not known; did you mean 'limit_presses'?"),
    (SOUND.replace('"recorded"', '"recordet"'), "did you mean 'recorded'?"),
    (with_bundle(""), "found no bundle, expected exactly one of bundle"),
    (with_bundle('bundle = "a"\nbundle_folder = "b"'), "found bundle and bundle_folder, expected exactly one"),
    (
        with_bundle('bundles = [{ path = "a", names = ["x"] }, { path = "b", names = ["x"] }]'),
        "the name 'x' is given to two bundles",
    ),
    *(
        (SOUND.replace("[station]\n", f"[station]\nprefix = {json.dumps(level)}\n"), "a topic level has 1 to 64 chara")
        for level in LEVELS
    ),
    *((f"{SOUND}[store]\n{line}\n", f"'store.{line.split(' ')[0]}'") for line in STORES),
    *(
        (f'{SOUND}[[sinks]]\nplugin = "mqtt"\noptions = {{ {line} }}\n', f"'sinks.1.options.{line.split(' ')[0]}'")
        for line in BROKERS
    ),
    *(
        (SOUND.replace('"recorded"', f'"{plugin}"').replace('"presses" }', f'"presses", pace = {pace} }}'),
         "'device.options.pace'")
        for plugin in ("recorded", "usb_mock") for pace in ("inf", "nan")
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "found"), REFUSED)
def test_what_no_station_can_work_with_is_refused(tmp_path: Path, text: str, found: str) -> None:
    """At the start, with the key: typing errors, topics that cannot be, attempts that would fail for ever."""
    assert found in refusal(tmp_path, text)


def test_a_missing_file_says_what_to_do(tmp_path: Path) -> None:
    """The first thing a newcomer gets wrong is the path."""
    with pytest.raises(ConfigError, match=r"does not exist; `gelgate check --example`"):
        load_config(tmp_path / "nothing.toml")


def test_a_file_that_is_not_text_is_refused(tmp_path: Path) -> None:
    """A binary file given by mistake is a sentence, not a traceback."""
    path = tmp_path / "gelgate.toml"
    path.write_bytes(b"\xff\xfe\x00")

    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(path)


def test_files_of_a_windows_editor_are_read(tmp_path: Path) -> None:
    """A byte order mark and CRLF: of a configuration, a password and a secret."""
    config, secret = tmp_path / "gelgate.toml", tmp_path / "secret"
    config.write_bytes(codecs.BOM_UTF8 + SOUND.replace("\n", "\r\n").encode())
    secret.write_bytes(codecs.BOM_UTF8 + b"word\r\n")
    secret.chmod(0o640)

    assert load_config(config).device.plugin == "recorded"
    assert (read_password(secret), read_secret(secret, "token_file", 4)) == ("word", b"word")


def test_the_tables_in_the_examples_comments_are_sound(tmp_path: Path) -> None:
    """Without their `# `, a pedal, a relay board with four outputs, and a PLC; its reject gate lets nothing through."""
    before, _, commented = example().partition("# A pedal, and")
    tables = "\n".join(line.removeprefix("#").removeprefix(" ") for line in commented.splitlines()[1:])
    (tmp_path / "gelgate.toml").write_text(before + tables, encoding="utf-8")
    config = load_config(tmp_path / "gelgate.toml")

    assert [trigger.action for trigger in config.triggers] == ["acknowledge"]
    assert [output.channel for output in config.actuators[0].outputs] == [1, 2, 2, 3]
    assert config.actuators[0].outputs[3].rule().when == set(VERDICTS) - {"pass"}
    assert config.handshake is not None
    assert config.handshake.plugin == "modbus"


def test_one_pedal_does_not_say_both_good_and_damaged(tmp_path: Path) -> None:
    """Without options each table opens the first pedal; with a key each, one pedal has two buttons."""
    before, _, _ = example().partition("# A pedal, and")
    path = tmp_path / "gelgate.toml"
    pedal = '\n[[triggers]]\nplugin = "hid_pedal"\naction = "{}"\noptions = {{ {} }}\n'.format
    path.write_text(before + pedal("good", "") + pedal("damaged", ""), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"hid_pedal have equal options, .* says `good` and `damaged`"):
        load_config(path)

    path.write_text(before + pedal("good", "key = 4") + pedal("damaged", "key = 5"), encoding="utf-8")
    assert len(load_config(path).triggers) == 2
