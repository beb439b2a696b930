"""`make sim`: runs of the station in a simulated world; the faults that an auditor finds, and what was reached."""

import argparse
import shutil
import sys
import tempfile
import time
from collections import Counter
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from simulation.bundles import both_bundles
from simulation.conditions import SOMETIMES
from simulation.schedule import Simulation
from simulation.surroundings import install_plugins


def main() -> int:
    words = argparse.ArgumentParser(prog="PYTHONPATH=tests/support python -m simulation", description=__doc__)
    words.add_argument("--seed", type=int, default=0, help="the first seed")
    words.add_argument(
        "--runs", type=int, default=0, help="seeds, one after the other; 0: until it is stopped"
    )
    words.add_argument("--presses", type=int, default=60, help="presses of a run")
    words.add_argument("--events", action="store_true", help="print what happens")
    words.add_argument("--bundle", type=Path, nargs=2, help="of both parts; by default new ones")
    words.add_argument(
        "--until-failed", type=float, default=0, help="end with the first failure, or after so many s"
    )
    given = words.parse_args()
    reached, begun, failed, done, turns = Counter[str](), time.perf_counter(), 0, 0, 0
    with tempfile.TemporaryDirectory() as made, contextmanager(install_plugins)(Path(made) / "packages"):
        folder = Path(made)
        bundles = given.bundle or both_bundles(folder)
        seeds = range(given.seed, given.seed + given.runs) if given.runs else count(given.seed)
        with suppress(KeyboardInterrupt):
            for seed in seeds:
                simulation = Simulation(seed, given.presses, bundles, folder / f"run{seed}")
                print(f"seed {seed}: {simulation.chosen}", flush=True)
                run = simulation.play()
                shutil.rmtree(folder / f"run{seed}")
                done, turns, reached = done + 1, turns + run.turns, reached + run.reached
                if given.events or run.faults:
                    print("\n".join([*run.events, *(f"seed {seed}: {fault}" for fault in run.faults)]))
                failed += bool(run.faults)
                if given.until_failed and (failed or time.perf_counter() - begun > given.until_failed):
                    break
    seconds = time.perf_counter() - begun
    print("\n".join(f"{number:8d} {name}" for name, number in sorted(reached.items())))
    print("".join(f"   NEVER {name}\n" for name in SOMETIMES if not reached[name]), end="")
    presses = done * given.presses
    print(
        f"{done} runs, {presses} presses and {turns} turns in {seconds:.0f} s, {presses / seconds:.1f} presses "
        f"a second; {failed} runs failed"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
