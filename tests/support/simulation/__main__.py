"""`make sim`: runs of the station in a simulated world until it is stopped; then the table of what was tried."""

import argparse
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from simulation.bundles import both_bundles
from simulation.conditions import SOMETIMES
from simulation.options import MEMORY
from simulation.schedule import Run
from simulation.search import Player, play_all, stop_at_signal

SAID_S = 10.0
"""How often a search says how far it is."""

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

    seeds: list[int] = field(default_factory=list)
    turns: int = 0
    events: int = 0
    reached: Counter[str] = field(default_factory=Counter)
    counted: Counter[str] = field(default_factory=Counter)
    failed: list[Run] = field(default_factory=list)
    kept: list[Path] = field(default_factory=list)
    """Their files."""

    def add(self, run: Run, path: Path | None) -> None:
        """Add one run, and its file where it has failed."""
        self.seeds.append(run.seed)
        self.turns, self.events = self.turns + run.turns, self.events + len(run.events)
        self.reached += run.reached
        self.counted += run.counted
        if path is not None:
            self.failed.append(run)
            self.kept.append(path)

    def summary(self, seconds: float) -> str:
        """Return one line: how much, how fast, and how far."""
        reached = sum(self.reached[name] > 0 for name in SOMETIMES)
        return (
            f"{len(self.seeds)} runs in {seconds:.0f} s: {self.counted['presses'] / seconds:.1f} presses, "
            f"{self.turns / seconds:.0f} turns and "
            f"{self.events / seconds:.0f} events a second; {reached} of {len(SOMETIMES)} conditions reached; "
            f"{len(self.failed)} runs failed"
        )

    def lines(self, seconds: float) -> Iterator[str]:
        """Return the table, what was reached and what never, and the files of what failed."""
        yield from (f"{number:8d} {name}" for name, number in sorted(self.reached.items()))
        yield from (f"   NEVER {name}" for name in SOMETIMES if not self.reached[name])
        for name, keys in TABLE.items():
            yield f"{sum(self.counted[key] for key in keys):10d} {name}"
        for what, words in {
            "lost": ("lost", "lack"),
            "doubled": (" rows", "of no row", "done 2"),
            "passed unjudged": ("passed", "shown"),
        }.items():
            told = [any(word in fault for fault in run.faults for word in words) for run in self.failed]
            yield f"{sum(told):10d} runs whose faults say: {what}"
        if self.seeds:
            yield f"seeds {min(self.seeds)} to {max(self.seeds)}"
        yield self.summary(seconds)
        yield from (f"kept in {path}" for path in self.kept)


def main() -> int:
    words = argparse.ArgumentParser(prog="PYTHONPATH=tests/support python -m simulation", description=__doc__)
    words.add_argument("--seed", type=int, default=0, help="the first seed")
    words.add_argument("--runs", type=int, default=0, help="so many seeds; 0: until Ctrl-C")
    words.add_argument("--seconds", type=float, default=0, help="begin no run after so long")
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
    begun, total, stop = time.perf_counter(), Total(), multiprocessing.get_context("spawn").Event()
    stop_at_signal(stop)
    with tempfile.TemporaryDirectory(dir=MEMORY) as made:
        folder = Path(made)
        bundles = given.bundle or both_bundles(folder)
        is_telling = given.events or given.runs == 1
        player = Player(given.presses, bundles, folder, stop, not given.no_shrink, is_telling)
        said, begun_processor = time.perf_counter(), time.process_time()
        for run, path in play_all(player, _seeds(given), given.jobs):
            total.add(run, path)
            now = time.perf_counter()
            if now - said > SAID_S:
                said = now
                print(total.summary(now - begun), flush=True)
            processor_s = time.process_time() - begun_processor
            if given.until_failed and (path or processor_s > given.until_failed):
                stop.set()
        print("\n".join(total.lines(time.perf_counter() - begun)), flush=True)
    return 1 if total.failed else 0


def _seeds(given: argparse.Namespace) -> Iterator[int]:
    """Give one after the other, until their time, or their number, is over."""
    begun = time.perf_counter()
    for number in count():
        is_late = given.seconds and time.perf_counter() - begun > given.seconds
        if is_late or number == (given.runs or -1):
            break
        yield given.seed + number


if __name__ == "__main__":
    sys.exit(main())
