"""What shared cores cost a fit: beside four busy processes, against one thread of linear algebra asked for outside.

Budget: at most 1.5 times. Two threads that wait for each other by spinning took more than ten times.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from statistics import median

import pytest
from station import press_recording

pytestmark = pytest.mark.bench

GELGATE = Path(sys.executable).parent / "gelgate"
ONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
ROUNDS, BUSY, PRESSES = 3, 4, 40


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that compute all the time."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in running:
            one.kill()
            one.wait()


def seconds(nominal: Path, variables: Mapping[str, str]) -> float:
    """One fit in a process of its own, started without any limit but these."""
    inherited = {name: value for name, value in os.environ.items() if name not in ONE}
    start = time.perf_counter()
    words = [GELGATE, "fit", nominal, "-o", nominal.parent / "made", "--part", "bolt", "--overwrite"]
    subprocess.run(list(map(str, words)), env={**inherited, **variables}, check=True, capture_output=True)
    return time.perf_counter() - start


def test_fit_beside_busy_processes(tmp_path: Path) -> None:
    """Medians of rounds in turn."""
    nominal = press_recording(tmp_path / "nominal", PRESSES)
    with busy(BUSY):
        rounds = [(seconds(nominal, {}), seconds(nominal, ONE)) for _ in range(ROUNDS)]
    ours, one = (median(times) for times in zip(*rounds, strict=True))
    print(f"\n{PRESSES} presses beside {BUSY} busy processes: {ours:.1f} s, with one thread {one:.1f} s")
    print(f"ratio {ours / one:.2f} (budget 1.5)")
