"""What a run that failed leaves in a file, so that it is not lost with the terminal."""

import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from simulation.schedule import Run
from simulation.shrinking import Failure

ROOT = Path(__file__).resolve().parents[3]
KEPT = ROOT / ".simulation"


def keep(run: Run, shortest: Failure | None, folder: Path) -> Path:
    """Write a run that failed over what there is of its seed at this commit. shortest: where it was shrunk."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{find_commit()}-seed-{run.seed}.txt"
    path.write_text("".join(f"{line}\n" for line in describe(run, shortest)), encoding="utf-8")
    return path


def describe(run: Run, shortest: Failure | None = None) -> Iterator[str]:
    """Give lines: what happened, what must not be, how the run plays again, and what becomes a test by pasting it."""
    failure = shortest or Failure.of(run)
    yield f"seed {run.seed}: {run.chosen}"
    yield from run.events
    yield from (f"seed {run.seed}: {fault}" for fault in run.faults)
    yield f"at commit {find_commit()}; again, event by event:"
    yield f"PYTHONPATH=tests/support .venv/bin/python -m simulation --seed {run.seed} --runs 1 --presses {run.presses}"
    size = f"{len(failure.schedule)} faults, {failure.presses} presses"
    yield f"{f'shrunk to {size}' if shortest else f'not shrunk, {size}'}; for FAILED in failed.py:"
    yield failure.text()


@cache
def find_commit() -> str:
    """Find the short name of the commit, with `+` where a file differs from it."""
    command = ("git", "-C", str(ROOT), "describe", "--always", "--dirty=+", "--exclude=*")
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    return said.stdout.strip() or "no-commit"
