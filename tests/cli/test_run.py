"""The installed command `gelgate`, as a service manager starts and stops it."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from breakable_station import Bench
from station import press_recording, small_bundle, station_config

GELGATE = Path(sys.executable).parent / "gelgate"
START_TIMEOUT_S = 120.0


def payloads(bench: Bench, topic: str) -> list[dict[str, object]]:
    """The payloads of a topic so far; a line that is being written is none yet."""
    log = bench.folder / "out" / "messages.jsonl"
    written = log.read_bytes().rpartition(b"\n")[0] if log.is_file() else b""
    lines = [json.loads(line) for line in written.splitlines()]
    return [line["payload"] for line in lines if line["topic"] == topic]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "SIGINT"])
def test_a_running_gateway_ends_in_good_order(bench: Bench, number: signal.Signals) -> None:
    """Stopped by a signal, it publishes `stopped`, prints its summary and ends with 0; no traceback."""
    config = bench.config()
    config.write_text(config.read_text().replace('"presses" }', '"presses", loop = true }'))
    running = subprocess.Popen(
        [GELGATE, "run", "--config", config], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + START_TIMEOUT_S
    while not payloads(bench, "gel") and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert payloads(bench, "gel"), "no frame arrived in time"
    running.send_signal(number)
    out, err = running.communicate(timeout=START_TIMEOUT_S)

    assert running.returncode == 0, err
    presses, frames = out.splitlines()[-2:]
    assert presses == "0 presses: none"
    assert re.fullmatch(r"\d+ frames: \d+ dropped, \d+ late, \d+ repeated, \d+ corrupt", frames)
    assert "Traceback" not in err
    assert payloads(bench, "state")[-1]["state"] == "stopped"


def test_without_a_terminal_sighup_reloads_and_does_not_end_it(bench: Bench) -> None:
    """As a service manager sends it: a bundle that is damaged since gives the alarm `bundle`, and the run goes on."""
    config = bench.config()
    config.write_text(config.read_text().replace('"presses" }', '"presses", loop = true }'))
    running = subprocess.Popen(
        [GELGATE, "run", "--config", config],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert awaited(bench, "gel", running), "no frame arrived in time"
    (bench.folder / "bundle" / "manifest.json").write_text("{}")
    running.send_signal(signal.SIGHUP)
    assert awaited(bench, "alarm/bundle", running), "no alarm came in time"
    running.terminate()
    _, err = running.communicate(timeout=START_TIMEOUT_S)

    assert running.returncode == 0, err
    assert "is not a gelgate manifest" in str(payloads(bench, "alarm/bundle")[-1])


def test_a_closed_terminal_ends_it(bench: Bench) -> None:
    """A person who closes the window does not leave a gateway behind."""
    config = bench.config()
    config.write_text(config.read_text().replace('"presses" }', '"presses", loop = true }'))
    ours, theirs = pty.openpty()
    command = [GELGATE, "run", "--config", config]
    running = subprocess.Popen(
        command, stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert awaited(bench, "gel", running), "no frame arrived in time"
    running.send_signal(signal.SIGHUP)
    _, err = running.communicate(timeout=START_TIMEOUT_S)
    os.close(ours)
    os.close(theirs)

    assert running.returncode == 0, err
    assert "stopped" in str(payloads(bench, "state")[-1])


def awaited(bench: Bench, topic: str, running: "subprocess.Popen[str]") -> bool:
    """Whether a message with content came to this topic before the time was over."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not any(payloads(bench, topic)) and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    return any(payloads(bench, topic))


def test_the_installed_command_refuses_with_its_exit_code(bench: Bench) -> None:
    """The console script, not only the function behind it."""
    done = subprocess.run([GELGATE, "run", "--config", "absent.toml"], capture_output=True, text=True)

    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("gelgate: configuration absent.toml does not exist")


def test_a_reader_that_leaves_early_is_no_fault(bench: Bench) -> None:
    """`gelgate station topics | head -1`: the pipe is closed while pages are still being printed."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([GELGATE, "topics"], stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)

    assert "Traceback" not in done.stderr


@pytest.fixture(scope="module")
def pressing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a recording with three presses and a bundle for them."""
    folder = tmp_path_factory.mktemp("pressing")
    press_recording(folder / "presses", 3, seed=2)
    small_bundle(folder / "bundle", press_recording(folder / "nominal", 12, seed=1))
    return folder


@pytest.fixture
def pressed(pressing: Path, tmp_path: Path) -> Path:
    """The configuration of a station that plays it."""
    return station_config(tmp_path, pressing / "presses", pressing / "bundle")


def published(config: Path) -> int:
    log = config.parent / "out" / "messages.jsonl"
    return sum(json.loads(line)["topic"] == "result" for line in log.read_text().splitlines())


def run(config: Path, out: int) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [GELGATE, "run", "--config", config], stdout=out, stderr=subprocess.PIPE, text=True, cwd=config.parent
    )


def test_lines_that_cannot_be_printed_do_not_end_the_inspection(pressed: Path) -> None:
    """Standard output on a full disk: every press is recorded and published, and the log says so once."""
    with Path("/dev/full").open("w") as full:
        done = run(pressed, full.fileno())

    assert done.returncode == 0, done.stderr
    assert done.stderr.count("inspection goes on") == 1
    assert "Traceback" not in done.stderr
    assert published(pressed) == 3


def test_a_reader_of_press_lines_that_leaves_does_not_end_the_inspection(pressed: Path) -> None:
    """`gelgate run | head -1`."""
    reading, writing = os.pipe()
    os.close(reading)
    done = run(pressed, writing)
    os.close(writing)

    assert done.returncode == 0, done.stderr
    assert published(pressed) == 3


def test_a_log_as_json_has_the_presses_too(pressed: Path) -> None:
    """Each line of the standard error output is one object; press lines are not printed as well."""
    done = subprocess.run(
        [GELGATE, "run", "--log-json", "--config", pressed],
        capture_output=True,
        text=True,
        cwd=pressed.parent,
    )
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    presses = [line for line in lines if line.get("event") == "press"]

    assert (done.returncode, done.stdout) == (0, "")
    assert [line["verdict"] for line in presses] == ["pass"] * 3
    assert [line["sequence"] for line in presses] == [1, 2, 3]
    assert len({line["press_id"] for line in presses}) == 3
    assert lines[-1]["event"] == "summary"
    assert all({"time", "level", "logger", "message"} <= set(line) for line in lines)


def test_what_a_run_writes_is_not_for_every_user(pressed: Path) -> None:
    """The database, its counts and the results: no rights for others."""
    assert run(pressed, subprocess.DEVNULL).returncode == 0

    made = [*pressed.parent.glob("gelgate.db*"), pressed.parent / "out/messages.jsonl"]
    assert len(made) >= 4
    assert [path.name for path in made if path.is_file() and path.stat().st_mode & 0o007] == []
