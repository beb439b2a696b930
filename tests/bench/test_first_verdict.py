"""From an empty environment to the first verdict on a part that nobody has fitted before: commands and seconds.

`make first-verdict` prints them; hosted CI runs it. The part and its sensor are simulated beforehand,
and the virtual sensor plays the presses as they were made, one in a second. A person needs longer for each.
"""

import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from command_line import ran

SOURCE = Path(__file__).resolve().parents[2]
SCENE = """
version = 1
name = "own"
part = "PZ4"
positions = ["pos1"]
effects = ["pose_jitter", "deformation", "illumination", "vignette", "noise"]
camera = { modes = ["lr"], fps = 10 }
runs = [{ name = "presses", presses = 30 }]
"""
VERDICT = re.compile(r" bolt/default  (PASS|FAIL|UNSURE) ")


def timed_lines(words: list[str], folder: Path) -> Iterator[tuple[float, str]]:
    """The lines of a command, each with the seconds since its start. It ends when no more are asked for."""
    started = time.monotonic()
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            yield time.monotonic() - started, line.rstrip()
        process.wait()
        yield time.monotonic() - started, f"exit code {process.returncode}"


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_three_commands_and_ten_minutes(tmp_path: Path) -> None:
    """An environment, the installation, and the guided command. What is not pressing is waiting: at most two minutes
    of the processor, for what else runs on this machine is none of it."""
    (tmp_path / "scene.toml").write_text(SCENE)
    ran("lab", "simulate", tmp_path / "scene.toml", "-o", tmp_path / "line", "--seed", 3)
    commands = [
        [sys.executable, "-m", "venv", "env"],
        ["env/bin/pip", "install", "--quiet", str(SOURCE)],
        [
            "env/bin/gelgate",
            "new-part",
            "bolt",
            "--yes",
            "--device",
            "usb_mock",
            "--option",
            "recording=line/presses",
        ],
    ]
    rows: list[tuple[str, float]] = []
    processor, first = [], None
    for words in commands:
        said, before = "nothing", _processor_s()
        for seconds, line in timed_lines(words, tmp_path):
            said = line
            if step := re.search(r"is ready after .*?: (.*)", line):
                rows += [(f"  {name}", float(n)) for name, n in re.findall(r"(\w+) (\d+) s", step[1])]
            if first is None and VERDICT.search(line):
                first = seconds
        assert said == "exit code 0", said
        processor.append(_processor_s() - before)
        rows.append((" ".join(Path(word).name for word in words[:3]), seconds if first is None else first))
    pressing = dict(rows)["  presses"]
    total = sum(seconds for name, seconds in rows if not name.startswith(" "))
    for name, seconds in (*rows, ("to the first verdict", total), ("of these waiting", total - pressing)):
        print(f"{name:32} {seconds:6.0f} s")
    print(f"{'processor time of the commands':32} {sum(processor):6.0f} s")

    assert len(commands) == 3
    assert first is not None
    assert total < 600
    assert sum(processor) < 120
