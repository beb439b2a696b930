"""`make sim-covered`: which lines of the rooms of the gateway run while a fault is on, or just after one.

Those that no running station calls, of verbs such as `gelgate station history`, are named and do not count."""

import argparse
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import cv2

from simulation.bundles import both_bundles
from simulation.options import MEMORY
from simulation.schedule import Simulation
from simulation.sensor import S
from simulation.station_code import ROOT, find_station_functions
from simulation.surroundings import install_plugins

ROOMS = ("edge/store", "edge/messaging", "edge/gateway", "edge/features")
AFTER_S = 3.0
"""So long after its end a fault still has its effect."""


class Lines:
    """The lines of functions, and which of them ran under a fault. A function of which all ran is not followed."""

    def __init__(self) -> None:
        self.is_fault = False
        self.wanted: dict[str, set[int]] = {}
        self.others: dict[str, int] = {}
        """Lines that are of other verbs."""
        self.left: dict[CodeType, set[int]] = {}
        station: dict[Path, set[int]] = {}
        for function in find_station_functions():
            station.setdefault(function.path, set()).update(function.lines)
        for room in ROOMS:
            for path in sorted((ROOT / room).rglob("*.py")):
                code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
                lines = {line for one in _functions(code) for line in _lines(one)}
                self.wanted[str(path)] = lines & station.get(path, set())
                self.others[str(path)] = len(lines) - len(self.wanted[str(path)])
        self.ran: dict[str, set[int]] = {path: set() for path in self.wanted}

    def call(self, frame: FrameType, event: str, argument: Any) -> Any:
        """Follow a call where lines of it are left; the interpreter calls it."""
        code = frame.f_code
        if not self.is_fault or code.co_filename not in self.wanted:
            return None
        left = self.left.get(code)
        if left is None:
            left = self.left[code] = _lines(code) - self.ran[code.co_filename]
        return self._line if left else None

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            self.ran[frame.f_code.co_filename].add(frame.f_lineno)
            self.left[frame.f_code].discard(frame.f_lineno)
        return self._line

    def report(self) -> Iterator[str]:
        """The share of each room, and what no fault has reached."""
        for room in ROOMS:
            files = {path: lines for path, lines in self.wanted.items() if path.startswith(str(ROOT / room))}
            total = sum(map(len, files.values()))
            ran = sum(len(self.ran[path] & lines) for path, lines in files.items())
            yield f"{room}: {ran} of {total} lines ran under a fault, {100 * ran / max(1, total):.1f} %"
            others = {path: self.others[path] for path in files if self.others[path]}
            named = ", ".join(
                f"{Path(path).relative_to(ROOT / room)} {number}" for path, number in others.items()
            )
            yield f"    {sum(others.values())} more lines are of other verbs than `gelgate run`: {named or 'none'}"
            for path, lines in files.items():
                if rest := sorted(lines - self.ran[path]):
                    yield f"    {Path(path).relative_to(ROOT)}: {', '.join(map(str, rest))}"


class Watched(Simulation):
    """A run whose lines are noted."""

    lines: Lines
    _fault_ns = 0

    def _turn(self) -> None:
        now_ns = self.world.clock.now_ns
        if self.ending or self.station.disk.kill_in is not None:
            self._fault_ns = now_ns
        self.lines.is_fault = self._fault_ns > now_ns - AFTER_S * S
        super()._turn()


def _functions(code: CodeType) -> Iterator[CodeType]:
    """The code of each function in a module; what stands outside of them runs once, at the import."""
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            if inner.co_flags & 0x2:  # of a function: it has local variables of its own
                yield inner
            yield from _functions(inner)


def _lines(code: CodeType) -> set[int]:
    """The lines of one function, without those of the functions in it."""
    return {line for _, _, line in code.co_lines() if line is not None and line != code.co_firstlineno}


def main() -> int:
    words = argparse.ArgumentParser(
        prog="PYTHONPATH=tests/support python -m simulation.covered", description=__doc__
    )
    words.add_argument("--seed", type=int, default=0, help="the first seed")
    words.add_argument("--seconds", type=float, default=300, help="end after the run that is on then")
    words.add_argument("--runs", type=int, default=0, help="so many seeds, however long they take")
    words.add_argument("--presses", type=int, default=60, help="presses of a run")
    given = words.parse_args()
    cv2.setNumThreads(1)
    lines, begun, seed = Lines(), time.perf_counter(), given.seed
    with tempfile.TemporaryDirectory(dir=MEMORY) as made:
        folder = Path(made)
        bundles = both_bundles(folder)
        threading.settrace(lines.call)
        sys.settrace(lines.call)
        with contextmanager(install_plugins)(folder / "packages"):
            while (
                seed - given.seed < given.runs if given.runs else time.perf_counter() - begun < given.seconds
            ):
                run = Watched(seed, given.presses, bundles, folder / f"run{seed}")
                run.lines = lines
                run.play()
                shutil.rmtree(folder / f"run{seed}")
                seed += 1
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
    print("\n".join(lines.report()))
    print(f"{seed - given.seed} runs in {time.perf_counter() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
