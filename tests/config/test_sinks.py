"""The names of receivers, and what is open to others."""

from pathlib import Path

from edge.config import load_config, sink_names
from edge.gateway.build import _names_before
from plugins.sinks.mqtt_options import MqttOptions, TlsOptions

from .test_config import SOUND, refusal, written

BROKER = '[[sinks]]\nplugin = "mqtt"\noptions = {{ host = "{}" }}\n'


def test_a_receiver_is_known_by_its_address_or_name_at_any_place(tmp_path: Path) -> None:
    """The same names in another order; a name in the file comes before the address."""
    a, b = BROKER.format("a"), BROKER.format("b") + 'name = "cloud"\n'
    there = sink_names(load_config(written(tmp_path, SOUND + a + b)).sinks)
    back = sink_names(load_config(written(tmp_path, SOUND + b + a)).sinks)

    assert there == [f"jsonl:{tmp_path / 'out'}", "mqtt:a:1883", "cloud"]
    assert set(back) == set(there)


def test_two_receivers_that_cannot_be_told_apart_are_refused(tmp_path: Path) -> None:
    """One would lose what the other has."""
    text = refusal(tmp_path, SOUND + BROKER.format("a") + BROKER.format("a"))

    assert "2 of them are 'mqtt:a:1883'" in text
    assert "give each a 'name'" in text


def test_names_of_older_databases_are_taken_over_for_plugins_used_once(tmp_path: Path) -> None:
    """Of two brokers it is not known which one was the first."""
    once = load_config(written(tmp_path, SOUND + BROKER.format("a")))
    twice = load_config(written(tmp_path, SOUND + BROKER.format("a") + BROKER.format("b")))

    assert _names_before(once)["mqtt"] == "mqtt:a:1883"
    assert "mqtt" not in _names_before(twice)


def test_what_is_open_to_others_is_a_warning(tmp_path: Path) -> None:
    """A connection that is not encrypted, a station without a name, a password that every user may read."""
    secret = tmp_path / "password"
    secret.write_text("s")
    secret.chmod(0o604)
    plain = MqttOptions(host="broker.plant").warnings()
    named = MqttOptions(host="localhost", username="station1", password_file=secret).warnings()
    secret.chmod(0o640)
    tls = TlsOptions(ca=tmp_path / "ca.crt")

    assert [text.partition(",")[0] for text in plain] == [
        "the connection is not encrypted; set tls",
        "no user name is given",
    ]
    assert named == [f"password file {secret} is open to every user; set its rights to 0640"]
    assert MqttOptions(host="broker.plant", tls=tls, username="a", password_file=secret).warnings() == []
    assert MqttOptions(host="127.0.0.1").warnings() == []
