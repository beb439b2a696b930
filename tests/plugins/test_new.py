"""`gelgate new` writes plugins that pass every check as they are, and work together as packages of another author."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from command_line import gelgate, ran
from station import press_recording, station_config
from stepped_station import SteppedStation

from edge import registry
from plugins.templates.command import GROUPS

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
NAMES = {"sink": "webhook", "device": "watched_folder", "detector": "deviations", "feature": "shifts"}
LONG = "a_name_of_thirty_characters_ok"


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with plugins of each kind: one to install, one of the longest name, and one of a short one."""
    folder = tmp_path_factory.mktemp("plugins")
    with chdir(folder):
        for kind in GROUPS:
            for name in (NAMES[kind], f"{kind}{LONG[len(kind) :]}", f"{kind[0]}{kind[-1]}"):
                told = ran("new", kind, name)
                assert f"{sys.executable} -m pip install -e gelgate-{name}" in told
    return folder


@pytest.fixture(scope="module")
def site(written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one of each kind, installed by pip."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-build-isolation"]
    sources = [written / f"gelgate-{name}" for name in NAMES.values()]
    subprocess.run([*pip, "--target", site, *sources], check=True, capture_output=True)
    return site


def run(folder: Path, *words: str | Path) -> None:
    """Run a program of the environment there. Errors: AssertionError with what it says."""
    done = subprocess.run(
        [BIN / words[0], *words[1:]], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_is_written_is_linted_formatted_and_typed(written: Path) -> None:
    """Lint and format whatever the length of its name."""
    run(written, "ruff", "check", "--no-cache", ".")
    run(written, "ruff", "format", "--no-cache", "--check", ".")
    packages = [f"gelgate-{name}" for name in NAMES.values()]
    run(written, "mypy", "--strict", "--cache-dir", ROOT / ".mypy_cache/strict", *packages)


def test_its_own_tests_pass(written: Path, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The published checks, where the package is installed."""
    monkeypatch.setenv("PYTHONPATH", str(site))
    packages = [f"gelgate-{name}" for name in NAMES.values()]
    run(written, "pytest", "-q", "-W", "error", "-p", "no:cacheprovider", *packages)


@pytest.mark.parametrize(
    ("kind", "name", "sentence"),
    [
        ("snk", "webhook", "'snk' is no kind of plugin that `gelgate new` writes; did you mean 'sink'?"),
        ("sink", "mqtt", "there is a sink named 'mqtt' already; choose another name"),
        ("feature", "scars", "there is a feature named 'scars' already; choose another name"),
        (
            "sink",
            "json",
            "'json' is the name of an installed module, which it would hide; choose another name",
        ),
        ("sink", "here", "gelgate-here is there already; choose another name, or remove it"),
        *(
            ("device", name, f"'{name}' cannot name a module; expected a lower-case letter, then")
            for name in ("Camera", "my-camera", "../x", "1st", "class", "", "x" * 31)
        ),
    ],
)
def test_a_name_that_cannot_be_used(
    kind: str, name: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sentence, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gelgate-here").mkdir()
    done = gelgate("new", kind, name)

    assert (done.code, done.err.startswith(f"gelgate: {sentence}")) == (3, True), done.err
    assert [*tmp_path.rglob("*")] == [tmp_path / "gelgate-here"]


class Handler(BaseHTTPRequestHandler):
    """Keeps what is posted."""

    def do_POST(self) -> None:
        payload = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.posted.append((self.path, payload))  # type: ignore[attr-defined]
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@contextmanager
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as found:
        found.posted = []  # type: ignore[attr-defined]
        thread = threading.Thread(target=found.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield found
        finally:
            found.shutdown()
            thread.join()


def test_from_nominal_presses_to_a_verdict_at_the_webhook(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is a sensor, the detector is fitted, the sink posts and the feature counts, with gelgate's own
    commands. A process that does not see the packages reads the bundle."""
    monkeypatch.syspath_prepend(site)
    registry._installed.cache_clear()
    registry._points.cache_clear()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ACME0001").mkdir()
    listed = gelgate("devices", "--device", "watched_folder", "--option", f"folder={tmp_path / 'ACME0001'}")
    assert "found    watched folder, serial ACME0001, 320x240" in listed.out
    nominal = press_recording(tmp_path / "nominal", 12, seed=1)
    line = press_recording(tmp_path / "line", 3, dented=[1], seed=2)
    options = ["--part", "bolt", "--method", "deviations", "--no-trunk", "--backbone", "tactile_lite0"]
    fit = gelgate("fit", nominal, "-o", "bolt", *options, "--set", "threshold=30")
    assert (fit.code, "deviations" in fit.out) == (0, True), fit.err
    assert "cannot be appended" not in fit.out
    run(tmp_path, "gelgate", "bundle", "verify", "bolt")

    with server() as webhook:
        url = f"http://127.0.0.1:{webhook.server_address[1]}"
        sinks = f'[[sinks]]\nplugin = "webhook"\noptions = {{ url = "{url}" }}\n'
        done = gelgate("run", "--config", station_config(tmp_path, line, tmp_path / "bolt", sinks=sinks))
        posted = list(webhook.posted)  # type: ignore[attr-defined]

    assert done.code == 0, done.err
    results = [json.loads(payload) for topic, payload in posted if topic.endswith("/result")]
    assert [result["verdict"] for result in results] == ["pass", "fail", "pass"]

    (tmp_path / "again").mkdir()
    served = '[commands]\nunsigned = ["shifts"]'
    with SteppedStation(
        station_config(tmp_path / "again", line, tmp_path / "bolt", tables=served)
    ) as station:
        station.play()
        assert (station.ask("shifts"), station.raised) == ({"shift 1": 3}, ["shifts"])
    registry._installed.cache_clear()
    registry._points.cache_clear()
