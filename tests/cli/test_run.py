"""The installed command `gelgate`, as a service manager starts and stops it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from breakable_station import Bench

GELGATE = Path(sys.executable).parent / "gelgate"
START_TIMEOUT_S = 60.0


def payloads(bench: Bench, topic: str) -> list[dict[str, object]]:
    """The payloads of a topic so far."""
    log = bench.folder / "out" / "messages.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
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


def test_the_installed_command_refuses_with_its_exit_code(bench: Bench) -> None:
    """The console script, not only the function behind it."""
    done = subprocess.run([GELGATE, "run", "--config", "absent.toml"], capture_output=True, text=True)

    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("gelgate: configuration absent.toml does not exist")


def test_a_reader_that_leaves_early_is_no_fault(bench: Bench) -> None:
    """`gelgate topics | head -1`: the pipe is closed while pages are still being printed."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([GELGATE, "topics"], stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)

    assert "Traceback" not in done.stderr
