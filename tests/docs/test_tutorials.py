"""docs/tutorials.md: files and commands, one section after the other in one folder, end as the page says."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
from command_line import gelgate

from edge.messaging.local_broker import LocalBroker

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The reader's folder, in which the first tutorial was done; on one core, where no process has to be started."""
    path = tmp_path_factory.mktemp("tutorials")
    before = Path.cwd()
    os.chdir(path)
    try:
        with mock.patch("os.cpu_count", return_value=1):
            (path / "printed.txt").write_text(follow("The first part"))
        yield path
    finally:
        os.chdir(before)


def section(title: str) -> str:
    return PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def follow(title: str, port: int = 1883) -> str:
    """Write the files of a section, run its commands, and return what they print."""
    text = section(title).replace("1883", str(port))
    printed = []
    for kind, block in re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL):
        if kind == "console":
            printed += [run(shlex.split(line)) for line in block.splitlines()]
        else:
            Path(block.partition("\n")[0].removeprefix("# ")).write_text(block)
    return "".join(printed)


def run(words: list[str]) -> str:
    if words[0] == "python":
        subprocess.run([sys.executable, *words[1:]], check=True, timeout=60)
        return ""
    done = gelgate(*words[1:])
    assert done.code == 0, done.err
    return done.out


def test_the_first_part_is_judged(folder: Path) -> None:
    """Three presses pass, and the two damaged ones fail."""
    assert "5 presses: 2 fail, 3 pass" in (folder / "printed.txt").read_text()
    assert (folder / "out" / "messages.jsonl").is_file()


def test_a_subscriber_prints_every_verdict(folder: Path) -> None:
    """The program of the page hears the five results and ends by itself."""
    (program,) = re.findall(r"```python\n(.*?)```", section("The first subscriber"), re.DOTALL)
    with LocalBroker() as broker:
        (folder / "subscriber.py").write_text(program.replace("1883", str(broker.port)))
        with subprocess.Popen(
            [sys.executable, "subscriber.py"], stdout=subprocess.PIPE, text=True
        ) as subscriber:
            assert subscriber.stdout is not None
            assert subscriber.stdout.readline() == "listening\n"
            follow("The first subscriber", broker.port)
            heard, _ = subscriber.communicate(timeout=60)

    assert [line.split()[1] for line in heard.splitlines()] == ["pass", "pass", "pass", "fail", "fail"]


def test_a_model_of_ones_own_gives_verdicts(folder: Path) -> None:
    assert re.search(r"\n5 presses: ", follow("The first model of your own"))
