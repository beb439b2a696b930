"""`make sim`: runs of the station in a simulated world; the table of what was tried, and each failure, shrunk."""

import argparse
import gc
import multiprocessing
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path

import cv2

from simulation.bundles import both_bundles
from simulation.conditions import SOMETIMES
from simulation.options import MEMORY
from simulation.schedule import Run, Simulation
from simulation.shrinking import Failure, kind_of, shrink
from simulation.surroundings import install_plugins

TABLE = {
    "presses": ("presses",),
    "crashes at chosen writes": ("crashes at a write",),
    "faults of brokers": ("faults of brokers",),
    "unplugs": ("unplug",),
    "other faults of the sensor": ("silence", "blind", "damage", "shake", "hold back"),
    "changes of gel and part": ("replace gel", "select part"),
    "reloads and restarts": ("reload", "stop"),
    "databases removed": ("lose database",),
    "steps of the clock": ("step clock",),
    "disk full, slow or faulty": ("fill disk", "slow disk", "bad disk"),
    "requests": ("request", "acknowledge"),
    "freezes of the process, or of its loop": ("freeze", "hang"),
    "faults of relay and pedal": ("relay", "pedal"),
    "faults of PLCs": ("plc", "second plc"),
}


@dataclass
class Total:
    """What several runs did together."""

    runs: int = 0
    turns: int = 0
    events: int = 0
    reached: Counter[str] = field(default_factory=Counter)
    counted: Counter[str] = field(default_factory=Counter)
    failed: list[Run] = field(default_factory=list)

    def add(self, run: Run) -> None:
        """Add one run."""
        self.runs, self.turns, self.events = (
            self.runs + 1,
            self.turns + run.turns,
            self.events + len(run.events),
        )
        self.reached += run.reached
        self.counted += run.counted
        if run.faults:
            self.failed.append(run)

    def lines(self, seconds: float) -> Iterator[str]:
        """The table, what was reached and what never."""
        yield from (f"{number:8d} {name}" for name, number in sorted(self.reached.items()))
        yield from (f"   NEVER {name}" for name in SOMETIMES if not self.reached[name])
        for name, keys in TABLE.items():
            yield f"{sum(self.counted[key] for key in keys):10d} {name}"
        said = " ".join(fault for run in self.failed for fault in run.faults)
        for what, words in {
            "lost": ("lost", "lack"),
            "doubled": (" rows", "of no row", "done 2"),
            "passed unjudged": ("passed", "shown"),
        }.items():
            yield f"{sum(word in said for word in words):10d} {what}"
        presses = self.counted["presses"]
        reached = sum(self.reached[name] > 0 for name in SOMETIMES)
        yield (
            f"{self.runs} runs in {seconds:.0f} s: {presses / seconds:.1f} presses, "
            f"{self.turns / seconds:.0f} turns and "
            f"{self.events / seconds:.0f} events a second; {reached} of {len(SOMETIMES)} conditions reached; "
            f"{len(self.failed)} runs failed"
        )


def main() -> int:
    words = argparse.ArgumentParser(prog="PYTHONPATH=tests/support python -m simulation", description=__doc__)
    words.add_argument("--seed", type=int, default=0, help="the first seed")
    words.add_argument(
        "--runs", type=int, default=0, help="seeds, one after the other; 0: until it is stopped"
    )
    words.add_argument("--seconds", type=float, default=0, help="end after the run that is on then")
    words.add_argument("--jobs", type=int, default=1, help="processes, each with seeds of its own")
    words.add_argument("--presses", type=int, default=0, help="presses of a run; by default they are drawn")
    words.add_argument("--events", action="store_true", help="print what happens")
    words.add_argument("--no-shrink", action="store_true", help="print a failure as it is")
    words.add_argument("--bundle", type=Path, nargs=2, help="of both parts; by default new ones")
    words.add_argument(
        "--until-failed",
        type=float,
        default=0,
        help="end with the first failure, or after so many s of processor time",
    )
    given = words.parse_args()
    begun, total = time.perf_counter(), Total()
    with tempfile.TemporaryDirectory(dir=MEMORY) as made:
        folder = Path(made)
        bundles = given.bundle or both_bundles(folder)
        if given.jobs == 1:
            for run in _plays(0, given, bundles, folder):
                total.add(run)
        else:
            from simulation.__main__ import play_all  # a process that is spawned knows it by this name

            # A fork would not have the threads that OpenCV has begun for the bundles, and would wait for them.
            with multiprocessing.get_context("spawn").Pool(given.jobs) as pool:
                parts = pool.imap_unordered(
                    partial(play_all, given=given, bundles=bundles, folder=folder), range(given.jobs)
                )
                for part in parts:
                    for run in part:
                        total.add(run)
        print("\n".join(total.lines(time.perf_counter() - begun)), flush=True)
        if total.failed and not given.no_shrink:
            with contextmanager(install_plugins)(folder / "packages"):
                for run in {kind_of(run.faults[0]): run for run in reversed(total.failed)}.values():
                    _shrink(run, bundles, folder)
    return 1 if total.failed else 0


def play_all(job: int, given: argparse.Namespace, bundles: Sequence[Path], folder: Path) -> list[Run]:
    """Play the seeds of one process."""
    return list(_plays(job, given, bundles, folder))


def _plays(job: int, given: argparse.Namespace, bundles: Sequence[Path], folder: Path) -> Iterator[Run]:
    """Play every job-th seed; a failure is printed."""
    cv2.setNumThreads(1)
    gc.collect()
    gc.freeze()  # each run asks what is in memory, which is not what was there before
    begun, begun_processor = time.perf_counter(), time.process_time()
    seeds = (
        range(given.seed + job, given.seed + given.runs, given.jobs)
        if given.runs
        else count(given.seed + job, given.jobs)
    )
    with contextmanager(install_plugins)(folder / f"packages{job}"), suppress(KeyboardInterrupt):
        for seed in seeds:
            simulation = Simulation(seed, given.presses, bundles, folder / f"run{seed}")
            run = simulation.play()
            shutil.rmtree(folder / f"run{seed}")
            if given.events or run.faults or given.runs == 1:
                said = [
                    f"seed {seed}: {run.chosen}",
                    *run.events,
                    *(f"seed {seed}: {fault}" for fault in run.faults),
                ]
                print("\n".join(said), flush=True)
            yield run
            is_late = given.seconds and time.perf_counter() - begun > given.seconds
            processor_s = time.process_time() - begun_processor
            if is_late or (given.until_failed and (run.faults or processor_s > given.until_failed)):
                break


def _shrink(run: Run, bundles: Sequence[Path], folder: Path) -> None:
    """Print the shortest schedule that fails alike."""
    failure = Failure.of(run)
    if kind := failure.says:
        print(
            f"seed {run.seed} fails: {kind} Shrinking {len(failure.schedule)} faults, {failure.presses} presses ...",
            flush=True,
        )
    shortest = shrink(failure, lambda tried: tried.play(bundles, folder).faults)
    print(
        f"{len(shortest.schedule)} faults, {shortest.presses} presses; for FAILED in failed.py:\n{shortest.text()}"
    )


if __name__ == "__main__":
    sys.exit(main())
