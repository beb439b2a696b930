"""The package of docs/plugins.md, installed as one of another author, works as the page says."""

import json
import os
import re
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from ports import free_port
from station import press_recording, station_config

from edge.clock import ManualClock
from edge.core.ports import Device, Message, Sink
from edge.core.sink_context import Station
from plugins.conformance import check_device, check_sink
from plugins.conformance.device import PERIOD_S, SIZE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/plugins.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```(?:python|toml)\n# (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
MODULES = [name for name in FILES if name.startswith("acme_touch/")]
MOST_LINES = 40


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's package, installed by pip."""
    source, site = tmp_path_factory.mktemp("acme"), tmp_path_factory.mktemp("site")
    for name, text in {**FILES, "acme_touch/__init__.py": ""}.items():
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text(text, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(site), str(source)], check=True, capture_output=True)
    (site / "test_acme_touch.py").write_text(FILES["test_acme_touch.py"], encoding="utf-8")
    return site


@pytest.fixture
def acme(site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The installed package can be imported here, too."""
    monkeypatch.syspath_prepend(site)
    return site


def gelgate(site: Path, *arguments: object, at: Path) -> str:
    """What the installed command prints in a process that sees the package. Errors: AssertionError for a refusal."""
    done = subprocess.run(
        [Path(sys.executable).parent / "gelgate", *map(str, arguments)],
        cwd=at, env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


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
    """Its entry points lead to the modules that are printed, and the first step of the page can be taken."""
    points = tomllib.loads(FILES["pyproject.toml"])["project"]["entry-points"]
    named = {
        value.partition(":")[0].replace(".", "/") + ".py"
        for group in points.values()
        for value in group.values()
    }

    assert named == set(MODULES)
    assert len(MODULES) == 3


@pytest.mark.parametrize("module", MODULES)
def test_a_plugin_is_one_short_file(module: str) -> None:
    """Under 40 lines, blank ones not counted; no plugin reaches below the contract."""
    lines = [line for line in FILES[module].splitlines() if line.strip()]

    assert len(lines) < MOST_LINES
    imported = [
        re.match(r"(?:from|import) ((?:edge|plugins|calibration|export)[.\w]*)", line) for line in lines
    ]
    assert [found[1] for found in imported if found and not found[1].startswith("edge.core.")] == []


def test_the_detectors_own_test_passes(site: Path) -> None:
    """The page's test file, run by pytest as its author would."""
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_acme_touch.py"]
    done = subprocess.run(
        run, cwd=site, env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True, text=True
    )

    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


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


def test_devices_lists_it(site: Path, tmp_path: Path) -> None:
    """`gelgate devices` finds the folder as a sensor."""
    folder = tmp_path / "ACME0001"
    folder.mkdir()

    listed = gelgate(
        site, "devices", "--device", "watched_folder", "--option", f"folder={folder}", at=tmp_path
    )

    assert "found    watched folder, serial ACME0001, 320x240" in listed


def test_from_nominal_presses_to_a_verdict_at_the_webhook(site: Path, tmp_path: Path) -> None:
    """Fitted by the package's detector, inspected, and posted by the package's sink, with gelgate's own commands."""
    nominal = press_recording(tmp_path / "nominal", 12, seed=1)
    line = press_recording(tmp_path / "line", 3, dented=[1], seed=2)
    fit = ("fit", nominal, "-o", "bolt", "--part", "bolt", "--method", "mean_distance", "--no-trunk")
    assert "mean_distance" in gelgate(site, *fit, at=tmp_path)

    gelgate(tmp_path, "bundle", "verify", "bolt", at=tmp_path)  # in a process that does not see the package

    with server() as webhook:
        url = f"http://127.0.0.1:{webhook.server_address[1]}"
        config = station_config(
            tmp_path,
            line,
            tmp_path / "bolt",
            sinks=f'[[sinks]]\nplugin = "webhook"\noptions = {{ url = "{url}" }}\n',
        )
        gelgate(site, "run", "--config", config, at=tmp_path)
        posted = list(webhook.posted)  # type: ignore[attr-defined]

    results = [json.loads(payload) for topic, payload in posted if topic.endswith("/result")]
    assert [result["verdict"] for result in results] == ["pass", "fail", "pass"]
    assert {result["method"] for result in results if "method" in result} <= {"mean_distance"}
