"""The installed command `gelgate`, as a service manager starts and stops it."""

import fcntl
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
from station import press_recording, small_bundle, station_config, variant

from edge.cli.run import Lines
from edge.store.database import open_read_only

GELGATE = Path(sys.executable).parent / "gelgate"
START_TIMEOUT_S = 120.0


def payloads(folder: Path, topic: str) -> list[dict[str, object]]:
    """Return the payloads of a topic so far; a line that is being written is none yet."""
    log = folder / "out" / "messages.jsonl"
    written = log.read_bytes().rpartition(b"\n")[0] if log.is_file() else b""
    lines = [json.loads(line) for line in written.splitlines()]
    return [line["payload"] for line in lines if line["topic"] == topic]


def wait_for(bench: Bench, topic: str, running: "subprocess.Popen[str]") -> None:
    """Wait until a message with content came to this topic."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not any(payloads(bench.folder, topic)):
        assert running.poll() is None
        assert time.monotonic() < deadline, f"nothing on {topic} in time"
        time.sleep(0.05)


def begun(bench: Bench, stdin: int) -> "subprocess.Popen[str]":
    """Start a gateway on presses that do not end."""
    config = bench.config()
    config.write_text(config.read_text().replace('"presses" }', '"presses", loop = true }'))
    command, pipe = [GELGATE, "run", "--config", config], subprocess.PIPE
    return subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe, text=True)


def started(bench: Bench, stdin: int) -> "subprocess.Popen[str]":
    """Begin, and return it once it has seen a frame."""
    running = begun(bench, stdin)
    wait_for(bench, "gel", running)
    return running


def acts(bench: Bench) -> list[str]:
    with open_read_only(bench.folder / "gelgate.db", "reading acts") as connection:
        return [verb for (verb,) in connection.execute("SELECT verb FROM acts")]


def end(bench: Bench, running: "subprocess.Popen[str]", number: signal.Signals) -> None:
    """Stopped by a signal, it publishes `stopped`, prints its summary and ends with 0; no traceback."""
    running.send_signal(number)
    out, err = running.communicate(timeout=START_TIMEOUT_S)

    assert running.returncode == 0, err
    presses, frames = out.splitlines()[-2:]
    assert presses == "0 presses: none"
    assert re.fullmatch(r"\d+ frames?: \d+ dropped, \d+ late, \d+ repeated, \d+ corrupt", frames)
    assert "Traceback" not in err
    assert payloads(bench.folder, "state")[-1]["state"] == "stopped"


def test_a_service_reloads_by_sighup_and_ends_by_sigterm(bench: Bench) -> None:
    """Without a terminal: a bundle that is damaged since gives the alarm `bundle`, and the run goes on."""
    running = started(bench, subprocess.DEVNULL)
    (bench.folder / "bundle" / "manifest.json").write_text("{}")
    running.send_signal(signal.SIGHUP)
    wait_for(bench, "alarm/bundle", running)
    end(bench, running, signal.SIGTERM)

    assert "is not a gelgate manifest" in str(payloads(bench.folder, "alarm/bundle")[-1])


def test_a_service_that_is_asked_to_reload_while_it_starts_does_not_end(bench: Bench) -> None:
    """It reloads when it runs; before it has read anything there is nothing to reload."""
    running = begun(bench, subprocess.DEVNULL)
    caught, deadline = 0, time.monotonic() + START_TIMEOUT_S
    while "numpy" not in Path(f"/proc/{running.pid}/maps").read_text(encoding="utf-8"):
        assert running.poll() is None
    running.send_signal(signal.SIGHUP)
    while not caught & 1 << signal.SIGHUP - 1:
        assert running.poll() is None
        assert time.monotonic() < deadline, "SIGHUP is not handled in time"
        status = Path(f"/proc/{running.pid}/status").read_text(encoding="utf-8")
        caught = int(re.findall(r"SigCgt:\s*(\w+)", status)[0], 16)
    running.send_signal(signal.SIGHUP)
    wait_for(bench, "gel", running)
    deadline = time.monotonic() + START_TIMEOUT_S
    while "open_bundles" not in acts(bench):
        assert time.monotonic() < deadline, "it has not reloaded in time"
        time.sleep(0.05)
    end(bench, running, signal.SIGTERM)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP], ids=["Ctrl-C", "a closed terminal"])
def test_a_person_at_a_terminal_ends_it(bench: Bench, number: signal.Signals) -> None:
    """Closing the window leaves no gateway behind."""
    ours, theirs = pty.openpty()
    end(bench, started(bench, theirs), number)
    os.close(ours)
    os.close(theirs)


def closed_pipe() -> int:
    """Return the end of a pipe whose reader has left."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def test_a_reader_that_leaves_early_is_no_fault() -> None:
    """`gelgate station topics | head -1`: the pipe is closed while pages are still being printed."""
    writing = closed_pipe()
    done = subprocess.run([GELGATE, "station", "topics"], stdout=writing, stderr=subprocess.PIPE, text=True)
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


def test_lines_that_nobody_reads_do_not_hold_up_the_inspection(pressed: Path) -> None:
    """As with a pager that waits, and a journal that hangs: both streams go into a full pipe."""
    reading, writing = os.pipe()
    os.write(writing, bytes(fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)))
    command = [GELGATE, "run", "--verbose", "--config", pressed]
    with subprocess.Popen(command, stdout=writing, stderr=writing, cwd=pressed.parent) as running:
        os.close(writing)
        try:
            code = running.wait(120)
        finally:
            running.kill()
            os.close(reading)

    assert code == 0
    assert len(payloads(pressed.parent, "result")) == 3


def test_the_reader_is_told_how_many_lines_were_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("edge.logs.PATIENCE_S", 0.0)
    lines = Lines()
    for is_read in (True, False, False, True, True):
        is_written = lines._writer._is_written
        (is_written.set if is_read else is_written.clear)()
        lines.put("press")

    assert capsys.readouterr().out.splitlines() == [
        "press",
        "2 lines left out: nothing was read here; inspection went on",
        "press",
        "press",
    ]


def test_a_part_that_the_terminal_cannot_spell_is_inspected(pressing: Path, tmp_path: Path) -> None:
    """As with a Japanese part and a terminal of western Europe: what it cannot show is an escape."""
    part = variant(pressing / "bundle", tmp_path / "bundle", part="\u90e8\u54c1")
    command = [GELGATE, "run", "--config", station_config(tmp_path, pressing / "presses", part)]
    western = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, capture_output=True, env=western, cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    assert done.stdout.count(b"\\u90e8\\u54c1/") == len(payloads(tmp_path, "result")) == 3


@pytest.mark.parametrize("output", ["a full disk", "a reader that left"])
def test_lines_that_cannot_be_printed_do_not_end_the_inspection(pressed: Path, output: str) -> None:
    """Every press is recorded and published, and nothing that is written is readable for every user."""
    out = os.open("/dev/full", os.O_WRONLY) if output == "a full disk" else closed_pipe()
    if output == "a full disk":  # a trial of the bundle leaves a file too
        (pressed.parent / "gelgate.db.tried").unlink()
    command = [GELGATE, "run", "--config", pressed]
    done = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True, cwd=pressed.parent)
    os.close(out)

    assert done.returncode == 0, done.stderr
    assert done.stderr.count("inspection goes on") == 1
    assert "Traceback" not in done.stderr
    assert len(payloads(pressed.parent, "result")) == 3
    made = [*pressed.parent.glob("gelgate.db*"), pressed.parent / "out/messages.jsonl"]
    assert len(made) >= 4
    assert [path.name for path in made if path.is_file() and path.stat().st_mode & 0o007] == []


@pytest.mark.parametrize(
    "closed", [*(pytest.param(one, marks=pytest.mark.lab) for one in (">&-", "2>&-")), "<&- >&- 2>&-"]
)
def test_closed_streams_do_not_end_the_inspection(pressed: Path, closed: str) -> None:
    """As a program starts it that closes them, and not to /dev/null."""
    command = ["sh", "-c", f'exec "$0" "$@" {closed}', GELGATE, "run", "--config", pressed]
    done = subprocess.run(command, capture_output=True, text=True, cwd=pressed.parent)

    assert done.returncode == 0, done.stderr
    assert len(payloads(pressed.parent, "result")) == 3


def test_a_log_as_json_has_the_presses_too(pressed: Path) -> None:
    """Each line of the standard error output is one object; press lines are not printed as well."""
    command = [GELGATE, "run", "--log-json", "--config", pressed]
    done = subprocess.run(command, capture_output=True, text=True, cwd=pressed.parent)
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    presses = [line for line in lines if line.get("event") == "press"]

    assert (done.returncode, done.stdout) == (0, "")
    assert [(line["verdict"], line["sequence"]) for line in presses] == [("pass", n) for n in (1, 2, 3)]
    assert len({line["press_id"] for line in presses}) == 3
    assert lines[-1]["event"] == "summary"
    assert all({"time", "level", "logger", "message"} <= set(line) for line in lines)
