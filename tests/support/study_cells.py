"""Cells and what evaluates them, in a module that worker processes can import."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.experiments.harness.cells import Cell
from calibration.progress import Advance
from edge.core.errors import FitError


def cells(count: int) -> list[Cell]:
    """Cells that differ in their seed."""
    return [
        Cell("good-fraction", "PZ1", "pos1", "padim", "corrected", "tiny", "press", seed, (("shots", 1),))
        for seed in range(count)
    ]


def seeds_of(rows: list[dict[str, Any]]) -> list[int]:
    """Sorted."""
    return sorted(int(row["seed"]) for row in rows)


@contextmanager
def quiet(what: str, total: int) -> Iterator[Advance]:
    """No progress display."""
    yield lambda done: None


@dataclass(frozen=True)
class Counted:
    """Leaves a file in the folder for each evaluation, and refuses to fit the cells whose seed is in `refused`."""

    folder: Path
    refused: tuple[int, ...] = ()

    def __call__(self, cell: Cell) -> dict[str, Any]:
        number = len(list(self.folder.glob(f"{cell.seed}-*")))
        (self.folder / f"{cell.seed}-{number}-{os.getpid()}").touch()
        if cell.seed in self.refused:
            raise FitError("too few presses")
        return {"aupro_001": cell.seed / 100}

    def times(self, seed: int) -> int:
        """How often the cell of this seed was evaluated."""
        return len(list(self.folder.glob(f"{seed}-*")))


@dataclass(frozen=True)
class DiesOnce:
    """Counts, and kills its own process at the first evaluation of one cell: as a worker out of memory is killed.
    always: at every evaluation."""

    counted: Counted
    seed: int
    always: bool = False

    def __call__(self, cell: Cell) -> dict[str, Any]:
        is_first = self.counted.times(cell.seed) == 0
        found = self.counted(cell)
        if cell.seed == self.seed and (is_first or self.always):
            os.kill(os.getpid(), signal.SIGKILL)
        return found


@dataclass(frozen=True)
class Interrupted:
    """Counts, and is interrupted with Ctrl-C at one cell."""

    counted: Counted
    seed: int

    def __call__(self, cell: Cell) -> dict[str, Any]:
        if cell.seed == self.seed:
            raise KeyboardInterrupt
        return self.counted(cell)


@dataclass(frozen=True)
class KillsScheduler:
    """Kills the scheduler in the middle of the study."""

    counted: Counted
    process_id: int

    def __call__(self, cell: Cell) -> dict[str, Any]:
        if cell.seed == 2:
            os.kill(self.process_id, signal.SIGKILL)
        return self.counted(cell)


def dies(task: object) -> None:
    """Kills its own process, as a process out of memory is killed."""
    os.kill(os.getpid(), signal.SIGKILL)
