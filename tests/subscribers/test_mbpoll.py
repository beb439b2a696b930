"""The walk of docs/plc.md with mbpoll, command by command as the page prints them. Run by `make test-subscribers`."""

import contextlib
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from handshake_bench import Bench, BenchHandshake

from edge.clock import SystemClock
from plugins.handshakes.modbus import ModbusServer
from plugins.handshakes.registers import STATUS_BITS

pytestmark = pytest.mark.subscribers

PAGE = (Path(__file__).parents[2] / "docs/plc.md").read_text(encoding="utf-8")


@pytest.fixture
def mbpoll() -> str:
    found = shutil.which("mbpoll")
    if found is None:
        pytest.skip("SKIPPED, NOT TESTED: mbpoll is not installed; apt-get install mbpoll")
    return found


def commands() -> Iterator[list[str]]:
    """The arguments of each command of the walk, with `$M` in their place."""
    base = re.search(r'M="mbpoll (.*)"', PAGE)
    assert base is not None
    for line in PAGE.splitlines():
        if line.startswith("$M"):
            yield [*base[1].split(), *line.partition("#")[0].split()[1:]]


def test_the_walk_of_the_page(mbpoll: str) -> None:
    """Each command does what its comment says, to the refused id."""
    bench = Bench()
    shown: list[set[str]] = []
    with contextlib.closing(ModbusServer("127.0.0.1", 0, SystemClock())) as server:
        server.start(BenchHandshake(bench))
        port = server.name.rpartition(":")[2]
        for number, arguments in enumerate(commands()):
            if number == 5:  # "now press the part"
                bench.press("pass")
            given = [port if one == "1502" else one for one in arguments]
            done = subprocess.run([mbpoll, *given], capture_output=True, text=True, timeout=30, check=False)
            print(" ".join(given), done.stdout, done.stderr)
            if "-t 1 " in " ".join(given):
                values = dict(re.findall(r"\[(\d+)\]:\s+(\d)", done.stdout))
                shown.append(
                    {name for n, (name, _, _) in enumerate(STATUS_BITS) if values.get(str(n)) == "1"}
                )
            last = done
    assert shown == [{"ready", "not passed"}, {"busy", "not passed"}, {"done", "pass"}]
    assert "Illegal data value" in last.stdout + last.stderr
