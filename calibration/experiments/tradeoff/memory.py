"""Peak memory of a process that loads one bundle and scores with it, each in a process of its own."""

import contextlib
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np

from calibration.experiments.tradeoff.machine import read_peak_bytes
from edge.core.errors import FitError, NotScorable
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer

__all__ = ["peak_bytes"]


def _peak(task: tuple[Path, int]) -> int | None:
    path, threads = task
    scorer = Scorer(Bundle.load(path), threads)
    frame = np.full((*scorer.frame, 3), 128, np.uint8)
    for _ in range(2):
        # A published score may overflow on grey; its memory is the same.
        with contextlib.suppress(NotScorable):
            scorer.score(frame)
    return read_peak_bytes("self")


def peak_bytes(
    bundles: Sequence[Path],
    threads: int,
    advance: Callable[[int], None] = lambda done: None,
    measure: Callable[[tuple[Path, int]], int | None] = _peak,
) -> list[int | None]:
    """The largest resident size of each process in bytes, interpreter and libraries included.

    None where the system does not show it. Processes are forked from one that has the libraries loaded and no session.
    measure: what a process does with a bundle and its threads. Errors: FitError for a process that dies.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["calibration.experiments.tradeoff.memory"])
    peaks: list[int | None] = []
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        for path in bundles:
            try:
                peaks.append(pool.submit(measure, (path, threads)).result())
            except BrokenProcessPool as error:
                raise FitError(
                    f"the process that measures the memory of '{path.name}' died, perhaps for lack of memory; free "
                    "some and give the same command again: finished points are kept"
                ) from error
            advance(len(peaks))
    return peaks
