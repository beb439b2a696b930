"""The package of docs/plugins.md, installed as one of another author, works as the page says."""

import json
import re
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from command_line import gelgate
from ports import free_port
from station import press_recording, station_config
from stepped_station import SteppedStation

from edge import registry
from edge.clock import ManualClock
from edge.core.ports import Device, Message, Sink
from edge.core.sink_context import Station
from plugins.conformance import check_device, check_sink
from plugins.conformance.device import PERIOD_S, SIZE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/plugins.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```(?:python|toml)\n# (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's package, installed by pip."""
    source, site = tmp_path_factory.mktemp("acme"), tmp_path_factory.mktemp("site")
    for name, text in {**FILES, "acme_touch/__init__.py": ""}.items():
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text(text, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(site), str(source)], check=True, capture_output=True)
    return site


@pytest.fixture
def acme(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The installed package can be imported here, too."""
    monkeypatch.syspath_prepend(site)
    registry._points.cache_clear()
    yield site
    registry._points.cache_clear()


class Handler(BaseHTTPRequestHandler):
    """Keeps what is posted; refuses what is longer than 1000 bytes."""

    def do_POST(self) -> None:
        payload = self.rfile.read(int(self.headers["Content-Length"]))
        is_kept = len(payload) <= 1000 or "heatmap" not in self.path
        if is_kept:
            self.server.posted.append((self.path.removeprefix("/"), payload))  # type: ignore[attr-defined]
        self.send_response(204 if is_kept else 413)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@contextmanager
def server(port: int = 0) -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", port), Handler) as found:
        found.posted = []  # type: ignore[attr-defined]
        thread = threading.Thread(target=found.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield found
        finally:
            found.shutdown()
            thread.join()


def test_the_page_shows_a_complete_package() -> None:
    """Its entry points lead to the modules that are printed; nothing reaches below the contracts."""
    points = tomllib.loads(FILES["pyproject.toml"])["project"]["entry-points"]
    values = [value for group in points.values() for value in group.values()]
    modules = {name: text for name, text in FILES.items() if name.startswith("acme_touch/")}
    ours = r"(?m)^(?:from|import) ((?:edge|plugins|calibration|export)[.\w]*)"
    imported = [name for text in modules.values() for name in re.findall(ours, text)]

    assert {value.partition(":")[0].replace(".", "/") + ".py" for value in values} == set(modules)
    assert len(modules) == 4
    assert {name for name in imported if not name.startswith("edge.core.")} == {
        "edge.messaging.alarm_payload",
        "edge.messaging.command_payloads",
        "edge.press_stage",
    }


def test_the_detectors_own_test_passes(acme: Path) -> None:
    """The page's test file."""
    names: dict[str, Any] = {}
    exec(FILES["test_acme_touch.py"], names)
    names["test_mean_distance"]()


class FolderBench:
    """The maker's program: it saves frames at once, or one by one as time passes."""

    def __init__(self, folder: Path) -> None:
        from acme_touch.watched_folder import FolderOptions

        self.clock = ManualClock()
        self._options = FolderOptions(folder=folder, size=SIZE)

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        from acme_touch.watched_folder import plugin

        self._options.folder.mkdir()
        start_ns = self.clock.monotonic_ns()
        pending = list(enumerate(payloads))
        if real_time:
            self.clock = SavingClock(
                start_ns, lambda now: self._save(pending, (now - start_ns) / 1e9 / PERIOD_S)
            )
        self._save(pending, 0 if real_time else len(payloads))
        return plugin.open(self._options, self.clock)

    def _save(self, pending: list[tuple[int, bytes]], until: float) -> None:
        while pending and pending[0][0] <= until:
            number, payload = pending.pop(0)
            (self._options.folder / f"{number:06}.jpg").write_bytes(payload)

    def unplug(self) -> None:
        self._options.folder.rename(self._options.folder.with_name("gone"))


class SavingClock(ManualClock):
    """Reports the time whenever it changes."""

    def __init__(self, now_ns: int, passed: object) -> None:
        super().__init__(now_ns)
        self._passed = passed

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        self._passed(self.monotonic_ns())  # type: ignore[operator]


def test_the_device_conforms(acme: Path, tmp_path: Path) -> None:
    """Every published check of devices."""
    numbers = iter(range(100))
    check_device(lambda: FolderBench(tmp_path / str(next(numbers))))


class WebhookBench:
    """A server on this machine, which stops and starts on one port."""

    def __init__(self) -> None:
        self._port = free_port()
        self._up = server(self._port)
        self._server = self._up.__enter__()

    def open(self, station: Station) -> Sink:
        from acme_touch.webhook import WebhookOptions, plugin

        return plugin.open(WebhookOptions(url=f"http://127.0.0.1:{self._port}"), station)

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        return self._server.posted[:n]  # type: ignore[attr-defined, no-any-return]

    def take_away(self) -> bool:
        self._up.__exit__(None, None, None)
        return True

    def bring_back(self) -> None:
        self._up = server(self._port)
        self._server = self._up.__enter__()

    def wait(self) -> None: ...

    def unwanted(self) -> Message | None:
        return Message("heatmap/1", bytes(2000), content_type="image/png")


def test_the_sink_conforms(acme: Path) -> None:
    """Every published check of sinks."""
    made: list[WebhookBench] = []

    def make() -> WebhookBench:
        made.append(WebhookBench())
        return made[-1]

    try:
        check_sink(make)
    finally:
        for bench in made:
            bench.take_away()


def test_from_nominal_presses_to_a_verdict_at_the_webhook(
    acme: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is a sensor, the package's detector is fitted, its sink posts and its feature counts, with gelgate's
    own commands. A process that does not see the package reads the bundle."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ACME0001").mkdir()
    listed = gelgate("devices", "--device", "watched_folder", "--option", f"folder={tmp_path / 'ACME0001'}")
    assert "found    watched folder, serial ACME0001, 320x240" in listed.out
    nominal = press_recording(tmp_path / "nominal", 12, seed=1)
    line = press_recording(tmp_path / "line", 3, dented=[1], seed=2)
    options = ["--part", "bolt", "--method", "mean_distance", "--no-trunk", "--backbone", "tactile_lite0"]
    fit = gelgate("fit", nominal, "-o", "bolt", *options, "--set", "threshold=30")
    assert (fit.code, "mean_distance" in fit.out) == (0, True), fit.err
    verify = [Path(sys.executable).parent / "gelgate", "bundle", "verify", "bolt"]
    subprocess.run(verify, check=True, capture_output=True)

    with server() as webhook:
        url = f"http://127.0.0.1:{webhook.server_address[1]}"
        sinks = f'[[sinks]]\nplugin = "webhook"\noptions = {{ url = "{url}" }}\n'
        done = gelgate("run", "--config", station_config(tmp_path, line, tmp_path / "bolt", sinks=sinks))
        posted = list(webhook.posted)  # type: ignore[attr-defined]

    assert done.code == 0, done.err
    results = [json.loads(payload) for topic, payload in posted if topic.endswith("/result")]
    assert [result["verdict"] for result in results] == ["pass", "fail", "pass"]

    served = '[commands]\nunsigned = ["shift_counts"]'
    (tmp_path / "again").mkdir()
    with SteppedStation(
        station_config(tmp_path / "again", line, tmp_path / "bolt", tables=served)
    ) as station:
        station.play()
        assert station.ask("shift_counts") == {"shift 1": 3}
        assert station.raised == ["shift_goal"]
