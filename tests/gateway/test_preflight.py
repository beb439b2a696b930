"""The check before the start; a gateway that cannot start leaves no connection, thread or lock."""

import random
import re
import socket
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from unittest.mock import Mock

import pytest
from ports import free_port
from sql import execute
from station import MQTT, Configure, mark_tried, station_config, two_parts, variant
from stepped_station import SteppedStation

from edge.acquisition import AcquisitionState
from edge.clock import SystemClock
from edge.config import PluginTable, load_config
from edge.core.errors import ConfigError, DeviceLost, StoreError
from edge.core.part_position import PartPosition
from edge.core.ports import Sink
from edge.gateway import preflight as module
from edge.gateway.build import open_station
from edge.gateway.preflight import Finding, preflight, try_sink
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.sink_worker import RetainedState
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.press_store import Store
from plugins.devices.usb_mock import UsbMock


def find(config: Path, part: str) -> list[Finding]:
    with preflight(load_config(config), SystemClock()) as checked:
        return [finding for finding in checked.findings if finding.part == part]


@pytest.mark.parametrize("host", ["broker..plant", "x" * 70 + ".plant"])
def test_a_name_that_no_host_can_have_is_a_sentence(host: str) -> None:
    """Python refuses such a name with another kind of error."""
    with pytest.raises(ConfigError, match=r"cannot be the name of a host; correct sinks\.1\.options\.host"):
        try_sink(PluginTable(plugin="mqtt", options={"host": host}), "sinks.1")


def test_a_name_server_that_is_silent_keeps_no_station_from_its_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A resolver waits for minutes, and nothing bounds it; results wait in the outbox as for a broker that is away."""
    ended = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_: ended.wait())
    monkeypatch.setattr(module, "CONNECT_TIMEOUT_S", 0.05)

    said = try_sink(PluginTable(plugin="mqtt", options={"host": "broker.plant"}), "sinks.1")

    ended.set()
    assert "broker.plant:1883 does not answer (not looked up in 0 s); results will wait in the outbox" in said


class Counted:
    """The number of calls of each slow step of a start."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: Counter[str] = Counter()
        for owner, name in ((Bundle, "load"), (Scorer, "check_golden"), (UsbMock, "open")):
            monkeypatch.setattr(owner, name, self._counting(f"{owner.__name__}.{name}", getattr(owner, name)))

    def _counting(self, key: str, real: Callable[..., object]) -> Callable[..., object]:
        def counted(*arguments: object, **options: object) -> object:
            self.calls[key] += 1
            return real(*arguments, **options)

        return staticmethod(counted) if key == "Bundle.load" else counted  # type: ignore[return-value]


def test_a_start_after_the_check_opens_everything_once(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bundle is loaded and hashed once, its golden frames are scored once, the sensor is opened once."""
    counted = Counted(monkeypatch)
    loaded, clock = load_config(config), SystemClock()
    with preflight(loaded, clock) as checked, open_station(loaded, clock, checked=checked) as station:
        assert [finding.error for finding in checked.findings] == [None] * 6
        acquisition = station.parts.acquisition
        acquisition.step()
        acquisition.step()
        assert acquisition.status.state is AcquisitionState.STREAMING

    assert counted.calls == {"Bundle.load": 1, "Scorer.check_golden": 1, "UsbMock.open": 1}


def test_a_check_without_a_start_gives_the_sensor_back(config: Path) -> None:
    """`gelgate check` twice in a row, and from two processes, finds it free."""
    loaded, clock = load_config(config), SystemClock()
    with preflight(loaded, clock) as checked:
        assert checked.device is not None
    with preflight(loaded, clock) as checked:
        held = checked.device
    assert held is not None
    with pytest.raises(DeviceLost):
        held.read(clock.monotonic_ns() + 10**9)


@pytest.mark.parametrize("licence", [None, "CC-BY-NC-4.0"])
def test_the_check_prints_the_licence_of_the_weights(
    tmp_path: Path, recording: Path, bundle: Path, licence: str | None
) -> None:
    """Weights that are not for commercial use are named as such; a bundle without a statement says nothing."""
    stated = {"backbone": {"licence": licence}}
    path = variant(bundle, tmp_path / "stated", facts=stated) if licence else bundle
    (finding,) = find(station_config(tmp_path / "station", recording, path), "bundle")

    words = "licence of the weights CC-BY-NC-4.0: not for commercial use, not for production"
    assert words in finding.text if licence else "licence" not in finding.text


def test_each_bundle_of_a_station_has_its_finding(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Sound ones with their golden frames, one with a fault, and one that is older than a bundle that was in use."""
    folder = tmp_path / "bundles"
    variant(bundle, folder / "a")
    variant(bundle, folder / "b", part="PZ1", revision=3)
    variant(bundle, folder / "c", part="PZ2")
    (folder / "c" / "head.onnx").write_bytes(b"cut")
    mark_tried(tmp_path / "gelgate.db", folder / "a", folder / "b")
    with Store(tmp_path / "gelgate.db") as store:
        store.use_bundle(PartPosition("PZ1", "pos1"), 4, "digest", 0)
    found = find(station_config(tmp_path, recording, f'bundle_folder = "{folder}"'), "bundle")

    assert [finding.error is None for finding in found] == [True, False, False]
    assert "has revision 3, and revision 4 was in use here" in found[1].text
    assert "head.onnx has SHA-256" in found[2].text


def test_a_clock_from_before_a_bundle_was_made_is_said(
    config: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A machine whose clock has no battery starts in the past: presses are judged, with wrong times."""
    assert find(config, "clock") == []
    monkeypatch.setattr("time.time_ns", lambda: 10**18)  # September 2001
    (finding,) = find(config, "clock")
    assert finding.error is None
    assert finding.text.startswith("warning: the clock of this machine says 2001-09-09, and bundle PZ")
    with module.preflight(load_config(config), SystemClock()):
        assert "says 2001-09-09" in caplog.text


def test_a_part_without_a_bundle_is_found_by_the_check(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """As at the start, where the part that was selected last comes first: then it is said and no fault."""
    lines = two_parts(tmp_path / "bundles", bundle) + '\npart = "PZ9"'
    config = station_config(tmp_path, recording, lines)
    mark_tried(tmp_path / "gelgate.db", tmp_path / "bundles" / "a", tmp_path / "bundles" / "b")
    (finding,) = find(config, "part")
    assert isinstance(finding.error, ConfigError)
    assert "inspection.part: " in finding.text
    assert "PZ9" in finding.text

    with Store(tmp_path / "gelgate.db") as store:
        store.use_bundle(PartPosition("PZ1", "pos1"), None, "digest", 0)
    (finding,) = find(config, "part")
    assert finding.error is None
    assert finding.text.startswith(
        "PZ1/pos1, selected last; inspection.part: no part of this station is named 'PZ9'"
    )


def test_a_start_waits_for_no_large_database(
    config: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """What it did not read is said, and read by a check."""
    monkeypatch.setattr(module, "READ_WITHIN_S", 0.0)
    loaded = load_config(config)
    Store(loaded.store.path).close()
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 60000) "
    execute(
        loaded.store.path,
        f"CREATE TABLE filler AS {numbers} SELECT i, hex(i) AS text FROM n",
        "CREATE INDEX by_text ON filler (text)",
    )

    def found(is_start: bool) -> str:
        with preflight(loaded, SystemClock(), is_start=is_start) as checked:
            (finding,) = (finding for finding in checked.findings if finding.part == "database")
        assert finding.error is None
        return finding.text

    said = "it was not read whole within 0 s; `gelgate db check` does it"
    assert found(is_start=True) == said
    assert said in caplog.text
    assert found(is_start=False) == "new"


def test_metrics_are_tried_where_they_are_wanted(configure: Configure) -> None:
    """A port that is taken is found by the check, not by the start; a free one is free again afterwards."""
    port = free_port()
    path = configure(tables=f"[metrics]\nport = {port}")
    with socket.create_server(("127.0.0.1", port)):
        (finding,) = find(path, "metrics")
    assert isinstance(finding.error, ConfigError)
    assert f"metrics.port {port} cannot be served" in finding.text
    for _ in range(2):
        (finding,) = find(path, "metrics")
        assert (finding.error, finding.text) == (None, f"http://127.0.0.1:{port}/metrics on this machine")


@pytest.mark.parametrize(
    ("table", "fault"),
    [
        (
            "[metrics]\nport = 5020",
            "metrics.port and handshake.options.port are both 5020; give each its own",
        ),
        ('[[sinks]]\nplugin = "page"\noptions = { port = 5020 }', "sinks.1.options.port and handshake"),
        ("[metrics]\nport = 5021", None),
    ],
)
def test_two_servers_of_a_station_have_two_ports(configure: Configure, table: str, fault: str | None) -> None:
    """Each alone may be free, and the start would say that a program uses it."""
    plc = '[handshake]\nplugin = "modbus"\noptions = { port = 5020 }\n'
    path = configure(sinks=MQTT % free_port(), tables=f"{table}\n{plc}")
    assert [fault and fault in one.text for one in find(path, "ports")] == ([True] if fault else [])


def test_the_check_prints_what_is_open_to_others(tmp_path: Path, recording: Path, bundle: Path) -> None:
    secret = tmp_path / "password"
    secret.write_text("s")
    secret.chmod(0o604)
    sink = (MQTT % free_port()).replace(" }", f', username = "a", password_file = "{secret}" }}')
    (finding,) = find(station_config(tmp_path, recording, bundle, sinks=sink), "sink mqtt")

    assert finding.error is None
    assert finding.text.endswith("is open to every user; set its rights to 0640")
    assert "; warning: password file" in finding.text


AWAY = 'plugin = "recorded"\noptions = { recording = "away" }\n'


@pytest.mark.parametrize(
    ("table", "words", "is_fault"),
    [
        ('plugin = "virtual_overview"', "virtual overview camera, serial VIRTUAL1$", False),
        # It is waited for; a picture of the empty station that is none will not come by waiting.
        (AWAY, "away.*; until it comes results come without its still$", False),
        (AWAY + 'codes = ["qr"]', "away.*; until it comes presses are refused$", False),
        (
            'plugin = "virtual_overview"\nempty = "empty.jpg"',
            r"overview\.empty: .*empty\.jpg is no picture",
            True,
        ),
    ],
)
def test_an_overview_camera_is_found_by_name_or_waited_for(
    configure: Configure, table: str, words: str, is_fault: bool
) -> None:
    (finding,) = find(configure(tables=f"[overview]\n{table}"), "overview")
    assert re.search(words, finding.text)
    assert isinstance(finding.error, ConfigError) == is_fault


def test_a_second_gateway_never_reaches_the_broker(configure: Configure) -> None:
    """Both have one client id: a connection of the second would disconnect the first from its broker."""
    with socket.create_server(("127.0.0.1", 0)) as broker:
        broker.settimeout(0.3)
        sinks = MQTT % broker.getsockname()[1]
        config = load_config(configure(sinks=sinks))
        with closing(PublisherLock(config.store.path)):
            refused = pytest.raises(StoreError, match="another gelgate process publishes")
            with refused, open_station(config, SystemClock()):
                pass
            with pytest.raises(TimeoutError):
                broker.accept()


def test_a_sink_that_cannot_be_opened_closes_those_before_it(configure: Configure) -> None:
    """The first sink's threads end, and the database is free again."""
    second = MQTT.replace("port = %d", 'username = "u", password_file = "/nowhere/password"')
    config = load_config(configure(sinks=MQTT % free_port() + second))
    before = set(threading.enumerate())
    refused = pytest.raises(ConfigError, match="password file /nowhere/password cannot be read")
    with refused, open_station(config, SystemClock()):
        pass

    assert "mqtt-commands" not in {thread.name for thread in set(threading.enumerate()) - before}
    PublisherLock(config.store.path).close()


def test_a_sink_that_breaks_while_it_is_closed_does_not_keep_the_others_open(tmp_path: Path) -> None:
    """Nor the database's lock."""
    path, good = tmp_path / "gelgate.db", Mock(Sink)
    bad = Mock(Sink, close=Mock(side_effect=RuntimeError("a plugin's own fault")))
    with Store(path):
        sinks = {"bad": bad, "good": good}
        running = Publisher(path, sinks, RetainedState(), SystemClock(), random.Random(0))
        running.start()
        running.stop()

    good.close.assert_called_once_with()
    PublisherLock(path).close()


def test_a_store_that_refuses_at_the_first_frame_is_waited_for(station: SteppedStation) -> None:
    """A database that cannot be written when the sensor appears halts the station, and does not end it."""
    with station.refusing("gels"):
        station.play_until(lambda: station.loop.is_halted)
        assert station.said("state")["state"] == "halted"
    station.turn()
    station.play()

    assert station.verdicts == ["pass", "fail", "pass"]
    assert station.said("state")["state"] == "ready"
