"""The check before the start: every part is tried once, and the start uses the opened parts."""

import json
import shutil
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from ports import free_port
from station import station_config, two_parts, variant

from edge.acquisition import AcquisitionState
from edge.clock import SystemClock
from edge.config import PluginTable, load_config
from edge.core.errors import ConfigError, DeviceLost
from edge.core.part_position import PartPosition
from edge.gateway.build import build
from edge.gateway.preflight import Finding, _try_sink, preflight
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.press_store import Store
from plugins.devices.usb_mock import UsbMock


@pytest.mark.parametrize("host", ["broker..plant", "x" * 70 + ".plant"])
def test_a_name_that_no_host_can_have_is_a_sentence(host: str) -> None:
    """Python refuses such a name with another kind of error."""
    with pytest.raises(ConfigError, match=r"cannot be the name of a host; correct sinks\.1\.options\.host"):
        _try_sink(PluginTable(plugin="mqtt", options={"host": host}), "sinks.1")


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


def test_a_start_after_the_check_opens_everything_once(
    tmp_path: Path, recording: Path, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bundle is loaded and hashed once, its golden frames are scored once, the sensor is opened once."""
    counted = Counted(monkeypatch)
    config, clock = load_config(station_config(tmp_path, recording, bundle)), SystemClock()
    with preflight(config, clock) as checked, ExitStack() as closing:
        assert [finding.error for finding in checked.findings] == [None] * 5
        acquisition = build(config, clock, closing, checked).acquisition
        acquisition.step()
        acquisition.step()
        assert acquisition.status.state is AcquisitionState.STREAMING

    assert counted.calls == {"Bundle.load": 1, "Scorer.check_golden": 1, "UsbMock.open": 1}


def test_a_check_without_a_start_gives_the_sensor_back(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """`gelgate check` twice in a row, and from two processes, finds it free."""
    config, clock = load_config(station_config(tmp_path, recording, bundle)), SystemClock()
    with preflight(config, clock) as checked:
        device = checked.take_device()
        assert device is not None
        device.close()
    with preflight(config, clock) as checked:
        held = checked._device
    assert held is not None
    with pytest.raises(DeviceLost):
        held.read(clock.monotonic_ns() + 10**9)


def test_the_check_prints_the_licence_of_the_weights(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Weights that are not for commercial use are named as such; a bundle without a statement says nothing."""
    stated = tmp_path / "stated"
    shutil.copytree(bundle, stated)
    manifest = json.loads((stated / "manifest.json").read_text())
    manifest["facts"]["backbone"] = {**manifest["facts"].get("backbone", {}), "licence": "CC-BY-NC-4.0"}
    (stated / "manifest.json").write_text(json.dumps(manifest))
    texts = {}
    for name, path in (("stated", stated), ("plain", bundle)):
        (tmp_path / name).mkdir(exist_ok=True)
        config = load_config(station_config(tmp_path / name, recording, path))
        with preflight(config, SystemClock()) as checked:
            texts[name] = checked.findings[0].text
    assert (
        "licence of the weights CC-BY-NC-4.0: not for commercial use, not for production" in texts["stated"]
    )
    assert "licence" not in texts["plain"]


def test_each_bundle_of_a_station_has_its_finding(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Sound ones with their golden frames, one with a fault, and one that is older than a bundle that was in use."""
    folder = tmp_path / "bundles"
    variant(bundle, folder / "a")
    variant(bundle, folder / "b", part="PZ1", revision=3)
    variant(bundle, folder / "c", part="PZ2")
    (folder / "c" / "head.onnx").write_bytes(b"cut")
    config, clock = (
        load_config(station_config(tmp_path, recording, f'bundle_folder = "{folder}"')),
        SystemClock(),
    )
    with Store(config.store.path) as store:
        store.use_bundle(PartPosition("PZ1", "pos1"), 4, "digest", 0)
    with preflight(config, clock) as checked:
        found = [finding for finding in checked.findings if finding.part == "bundle"]

    assert [finding.error is None for finding in found] == [True, False, False]
    assert "has revision 3, and revision 4 was in use here" in found[1].text
    assert "head.onnx has SHA-256" in found[2].text


def test_a_part_without_a_bundle_is_found_by_the_check(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """As at the start, where the part that was selected last comes first."""
    inspection = two_parts(tmp_path / "bundles", bundle) + '\npart = "PZ9"'
    config = load_config(station_config(tmp_path / "station", recording, inspection))
    with preflight(config, SystemClock()) as checked:
        (finding,) = [finding for finding in checked.findings if finding.part == "part"]
    assert isinstance(finding.error, ConfigError)
    assert "inspection.part: " in finding.text
    assert "PZ9" in finding.text

    with Store(config.store.path) as store:
        store.use_bundle(PartPosition("PZ1", "pos1"), None, "digest", 0)
    with preflight(config, SystemClock()) as checked:
        assert [finding.text for finding in checked.findings if finding.part == "part"] == ["PZ1/pos1"]


def test_metrics_are_tried_where_they_are_wanted(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """A port that is taken is found by the check, not by the start; a free one is free again afterwards."""
    path = station_config(tmp_path, recording, bundle)
    port = free_port()
    with socket.create_server(("127.0.0.1", port)):
        path.write_text(path.read_text() + f"[metrics]\nport = {port}\n")
        with preflight(load_config(path), SystemClock()) as checked:
            (finding,) = [finding for finding in checked.findings if finding.part == "metrics"]
    assert isinstance(finding.error, ConfigError)
    assert f"metrics.port {port} cannot be served" in finding.text

    for _ in range(2):
        with preflight(load_config(path), SystemClock()) as checked:
            (finding,) = [finding for finding in checked.findings if finding.part == "metrics"]
        assert (finding.error, finding.text) == (None, f"http://127.0.0.1:{port}/metrics on this machine")


def test_the_check_prints_what_is_open_to_others(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Behind what it found of the receiver."""
    secret = tmp_path / "password"
    secret.write_text("s")
    secret.chmod(0o604)
    with socket.socket() as away:
        away.bind(("127.0.0.1", 0))
        broker = (
            f'host = "127.0.0.1", port = {away.getsockname()[1]}, username = "a", password_file = "{secret}"'
        )
        sink = f'[[sinks]]\nplugin = "mqtt"\noptions = {{ {broker} }}\n'
        path = station_config(tmp_path, recording, bundle, sinks=sink)
        with preflight(load_config(path), SystemClock()) as checked:
            (finding,) = [finding for finding in checked.findings if finding.part == "sink mqtt"]

    assert finding.error is None
    assert finding.text.endswith("is open to every user; set its rights to 0640")
    assert "; warning: password file" in finding.text


def overview_finding(folder: Path, recording: Path, bundle: Path, table: str) -> Finding:
    path = station_config(folder, recording, bundle)
    path.write_text(path.read_text() + f"\n[overview]\n{table}\n")
    with preflight(load_config(path), SystemClock()) as checked:
        (found,) = (one for one in checked.findings if one.part == "overview")
    return found


def test_an_overview_camera_is_found_by_name(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """A station without one has no such line."""
    found = overview_finding(tmp_path, recording, bundle, 'plugin = "virtual_overview"')

    assert (found.text, found.error) == ("virtual overview camera, serial VIRTUAL1", None)


@pytest.mark.parametrize(
    ("more", "effect"),
    [("", "results come without its still"), ('codes = ["qr"]', "presses are refused")],
)
def test_an_overview_camera_that_is_away_is_no_fault(
    tmp_path: Path, recording: Path, bundle: Path, more: str, effect: str
) -> None:
    """The station starts and waits for it; the finding says what happens until then."""
    table = f'plugin = "recorded"\noptions = {{ recording = "away" }}\n{more}'
    found = overview_finding(tmp_path, recording, bundle, table)

    assert found.error is None
    assert "away" in found.text
    assert found.text.endswith(f"; until it comes {effect}")


def test_a_picture_of_the_empty_station_that_is_none_is_a_fault(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """It will not come by waiting."""
    table = 'plugin = "virtual_overview"\nempty = "empty.jpg"'

    assert isinstance(overview_finding(tmp_path, recording, bundle, table).error, ConfigError)
