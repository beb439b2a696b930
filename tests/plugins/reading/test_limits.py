"""The process that opens foreign files has limits, and refuses what reading never needs."""

import json
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import ConfigError
from plugins.reading import isolated
from plugins.reading.isolated import read_foreign

MEMORY, CPU_S, DISK = 4 << 30, 60, 64 << 20
# A process of one thread, as `read_foreign` starts it, may have a namespace of its own.
SINGLE = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def child(
    folder: Path, *, memory: int = MEMORY, cpu_s: int = CPU_S, disk: int = DISK
) -> subprocess.CompletedProcess[str]:
    """The reader's process on `model.pkl`, with these limits."""
    limits = [str(memory), str(cpu_s), str(disk)]
    command = [sys.executable, "-m", "plugins.reading.child", str(folder / "model.pkl"), str(folder / "out")]
    return subprocess.run([*command, *limits], capture_output=True, text=True, env=SINGLE)


def answer(folder: Path) -> dict[str, str]:
    found: dict[str, str] = json.loads((folder / "out" / "content.json").read_text())
    return found


def growing(path: Path, times: int, *, is_kept: bool) -> None:
    """A pickle of one megabyte that makes a new megabyte of bytes with every few bytes of code."""
    text, make = pickle.dumps("x" * (1 << 20), 2)[2:-1], b"h\x00h\x01\x86R"
    start = b"\x80\x02" + text + b"0X\x06\x00\x00\x00latin1q\x010c_codecs\nencode\nq\x020"
    if is_kept:
        path.write_bytes(start + b"](" + (b"h\x02" + make) * times + b"e.")
    else:
        path.write_bytes(start + (b"h\x02" + make + b"0") * times + b"N.")


def test_memory_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte that asks for one and a half times the limit: a sentence with it, and the caller lives on."""
    assert isolated.BASE_BYTES == 2 << 30
    monkeypatch.setattr(isolated, "BASE_BYTES", 512 << 20)
    growing(tmp_path / "model.pkl", 750, is_kept=True)

    with (
        pytest.raises(ConfigError, match=r"model\.pkl was not imported: .* more than the \d+ MiB allowed"),
        read_foreign(tmp_path / "model.pkl"),
    ):
        pass


def test_time_is_limited(tmp_path: Path) -> None:
    """Work for more than a second of the processor ends after one."""
    growing(tmp_path / "model.pkl", 100_000, is_kept=False)

    done = child(tmp_path, cpu_s=1)

    assert done.returncode in (-signal.SIGKILL, -signal.SIGXCPU)
    assert not (tmp_path / "out" / "content.json").exists()


def test_files_are_limited(tmp_path: Path) -> None:
    """What the reader writes fits a limit too."""
    (tmp_path / "model.pkl").write_bytes(pickle.dumps(np.zeros(400_000)))

    child(tmp_path, disk=1 << 20)

    assert "an array of it exceeds the 1 MiB allowed" in answer(tmp_path)["error"]


BREACH = """
import socket, subprocess, sys, os
from pathlib import Path
import plugins.reading.child as child

def breached(path):
    {action}
    return "pickle", Path("/proc/self/net/dev").read_text().split()

child.read_here = breached
child.main(Path(sys.argv[1]), Path(sys.argv[2]), 4 << 30, 60, 1 << 20)
"""
"""As if a file could run code in the reader: the fence behind the unpickler."""


def breach(folder: Path, action: str) -> dict[str, str]:
    (folder / "model.pkl").write_bytes(b"N.")
    command = [sys.executable, "-c", BREACH.format(action=action)]
    subprocess.run([*command, str(folder / "model.pkl"), str(folder / "out")], check=True, env=SINGLE)
    return answer(folder)


@pytest.mark.parametrize(
    ("action", "event"),
    [
        ("socket.socket()", "socket.__new__"),
        ("subprocess.run(['true'])", "subprocess.Popen"),
        ("os.system('true')", "os.system"),
        ("os.remove(path)", "os.remove"),
        ("os.fork()", "os.fork"),
        ("import ftplib", "import"),
        ("exec('1')", "compile"),
    ],
)
def test_what_reading_never_needs_ends_it(tmp_path: Path, action: str, event: str) -> None:
    """Sockets, programs, changed files, new code: the sentence names the event, and nothing is done."""
    assert f"the reader has no use for {event}" in breach(tmp_path, action)["error"]
    assert (tmp_path / "model.pkl").exists()


def test_a_network_namespace_has_no_network(tmp_path: Path) -> None:
    """Where the system gives one, the only interface is the loopback, which is down."""
    found = breach(tmp_path, "pass")

    if "own network namespace" not in found["isolation"]:
        pytest.skip("this system gives no network namespace; the reader says so")
    interfaces = {row[1] for row in found["values"] if str(row[1]).endswith(":")}
    assert interfaces == {"lo:"}
