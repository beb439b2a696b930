"""Peak memory of a process that loads one bundle and scores with it, each in a process of its own."""

import multiprocessing
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from edge.model.bundle import Bundle
from edge.model.scorer import Scorer

__all__ = ["peak_bytes"]

_STATUS = Path("/proc/self/status")


def peak_bytes(
    bundles: Sequence[Path], threads: int, advance: Callable[[int], None] = lambda done: None
) -> list[int | None]:
    """The largest resident size of each process in bytes, interpreter and libraries included.

    None where the system does not show it. Processes are forked from one that has the libraries loaded and no session.
    """
    if not _STATUS.is_file():
        return [None] * len(bundles)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["calibration.tradeoff.memory"])
    found: list[int | None] = []
    with context.Pool(1, maxtasksperchild=1) as pool:
        for size in pool.imap(_peak, [(path, threads) for path in bundles], chunksize=1):
            found.append(size)
            advance(len(found))
    return found


def _peak(task: tuple[Path, int]) -> int | None:
    path, threads = task
    scorer = Scorer(Bundle.load(path), threads)
    frame = np.full((*scorer.frame, 3), 128, np.uint8)
    for _ in range(2):
        scorer.score(frame)
    lines = _STATUS.read_text().splitlines()
    sizes = [int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")]
    return sizes[0] if sizes else None
