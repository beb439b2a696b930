"""`make sim-planted`: bugs that are planted one by one in a copy of the program; each must be found and named."""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from simulation.bundles import both_bundles
from simulation.planted_bugs import BUGS, Bug
from simulation.planted_by_others import BY_OTHERS

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("edge", "plugins", "calibration", "tests/support")


def main() -> int:
    words = argparse.ArgumentParser(prog="python -m simulation.planted", description=__doc__)
    words.add_argument("names", nargs="*", help="by default all")
    words.add_argument("--seconds", type=float, default=60, help="of processor time, of the runs with each")
    words.add_argument("--bundle", type=Path, nargs=2, help="of both parts; by default new ones")
    given = words.parse_args()
    missed = 0
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        bundles = given.bundle or both_bundles(folder)
        for bug in (*BUGS, *BY_OTHERS):
            if not given.names or bug.name in given.names:
                said = find(bug, folder / "tree", bundles, given.seconds)
                print(f"{bug.name}: {said}", flush=True)
                missed += not said.startswith("found")
    print(f"{missed} bugs were not found, or not named")
    return 1 if missed else 0


def find(bug: Bug, tree: Path, bundles: list[Path], seconds: float) -> str:
    """Plant it, and say what the runs say."""
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    try:
        plant(bug, tree)
        begun = time.perf_counter()
        run = subprocess.run(
            [
                sys.executable,
                "-m",
                "simulation",
                "--bundle",
                *bundles,
                "--until-failed",
                str(seconds),
                "--no-shrink",
            ],
            env={**os.environ, "PYTHONPATH": f"{tree}:{tree / 'tests/support'}"},
            cwd=tree,
            capture_output=True,
            text=True,
            check=False,
        )
        took_s = time.perf_counter() - begun
    finally:
        shutil.rmtree(tree)
    said = [line for line in run.stdout.splitlines() if line.startswith("seed ")]
    runs = next((line.split()[0] for line in reversed(run.stdout.splitlines()) if " runs in " in line), "0")
    faults = [line for line in said if "Chosen" not in line]
    if run.returncode == 0:
        return f"NOT FOUND in {runs} runs, {took_s:.0f} s"
    if not faults:
        return f"NOT NAMED, the program ended: {(run.stderr.splitlines() or ['?'])[-1]}"
    named = next((line for line in faults if re.search(bug.sentence, line)), None)
    return f"{'found' if named else 'NOT NAMED'} in run {runs}, {took_s:.0f} s: {named or faults[0]}"


def plant(bug: Bug, tree: Path) -> None:
    """Change the copy. Errors: ValueError where the program is not as the bug expects."""
    path = tree / bug.file
    text = path.read_text(encoding="utf-8")
    if text.count(bug.old) != 1:
        raise ValueError(f"{bug.name}: {bug.file} has the text {text.count(bug.old)} times: {bug.old!r}")
    path.write_text(text.replace(bug.old, bug.new), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
