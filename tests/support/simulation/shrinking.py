"""From a run that failed to a short schedule that fails alike: fewer presses, fewer kinds of fault, fewer faults."""

import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from simulation.chosen import Chosen, Fault
from simulation.schedule import Run, Simulation

LEARNT_S = 4.0


@dataclass(frozen=True)
class Failure:
    """A run that failed, so that it plays again: `Simulation(**vars)` of all but `says`."""

    seed: int
    presses: int
    chosen: Chosen
    schedule: tuple[Fault, ...]
    says: str
    """What an auditor said, without its numbers."""

    @classmethod
    def of(cls, run: Run) -> "Failure":
        """Take it from a run."""
        chosen = replace(run.chosen, rates={})
        return cls(run.seed, run.presses, chosen, tuple(run.schedule), kind_of(run.faults[0]))

    def play(self, bundles: Sequence[Path], folder: Path) -> Run:
        """Play it again in a new folder."""
        with tempfile.TemporaryDirectory(dir=folder) as own:
            simulation = Simulation(self.seed, self.presses, bundles, Path(own), self.chosen, self.schedule)
            return simulation.play()

    def text(self) -> str:
        """Write it as Python, to be pasted into `failed.py`."""
        faults = "".join(f"        {fault!r},\n" for fault in self.schedule)
        default = vars(Chosen())
        chosen = ", ".join(f"{key}={own!r}" for key, own in vars(self.chosen).items() if own != default[key])
        return (
            f"Failure(\n    seed={self.seed},\n    presses={self.presses},\n    chosen=Chosen({chosen}),\n"
            f"    schedule=(\n{faults}    ),\n    says={self.says!r},\n)"
        )


def kind_of(fault: str) -> str:
    """Leave out what differs from run to run: numbers, ids and lists of reasons."""
    return re.sub(r"\(.*?\)|\[.*?\]|\b[0-9A-Z]{26}\b|-?\d+(\.\d+)?", "#", fault)


def shrink(failure: Failure, plays: Callable[[Failure], Sequence[str]], most: int = 120) -> Failure:
    """Return the shortest that fails alike. plays: what the auditors say of a run. most: runs that are tried."""
    left = most

    def fails(tried: Failure) -> bool:
        nonlocal left
        left -= 1
        return left >= 0 and failure.says in map(kind_of, plays(tried))

    shortest = _fewer_presses(failure, fails)
    for name in sorted({fault.name for fault in shortest.schedule}):
        without = tuple(fault for fault in shortest.schedule if fault.name != name)
        tried = replace(shortest, schedule=without)
        shortest = tried if fails(tried) else shortest
    size = max(1, len(shortest.schedule) // 2)
    while size:
        start = 0
        while start < len(shortest.schedule):
            kept = shortest.schedule[:start] + shortest.schedule[start + size :]
            tried = replace(shortest, schedule=kept)
            if fails(tried):
                shortest = tried
            else:
                start += size
        size //= 2
    return _fewer_presses(_earlier(shortest, fails), fails)


def _earlier(failure: Failure, fails: Callable[[Failure], bool]) -> Failure:
    """Let the first fault begin when the gel has just been learnt."""
    if not failure.schedule:
        return failure
    early_s = failure.schedule[0].at_s - LEARNT_S
    moved = tuple(replace(fault, at_s=round(fault.at_s - early_s, 6)) for fault in failure.schedule)
    tried = replace(failure, schedule=moved)
    return tried if early_s > 0 and fails(tried) else failure


def _fewer_presses(failure: Failure, fails: Callable[[Failure], bool]) -> Failure:
    """Halve the way to the fewest presses with which it still fails."""
    least, enough = 1, failure.presses
    while least < enough:
        middle = (least + enough) // 2
        if fails(replace(failure, presses=middle)):
            enough = middle
        else:
            least = middle + 1
    return replace(failure, presses=enough)
