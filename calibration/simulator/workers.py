"""Parallel work in processes: results in order, few held at once, and an interrupt leaves complete files."""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from itertools import islice
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

__all__ = ["in_order", "in_processes"]

Task = TypeVar("Task")
Result = TypeVar("Result")


def in_order(work: Callable[[Task], Result], tasks: Iterable[Task], workers: int) -> Iterator[Result]:
    """The results of the tasks, in their order, as from `in_processes`; with one worker no process is started."""
    if workers < 1:
        raise ValueError(f"at least one worker is needed, found {workers}")
    return map(work, tasks) if workers == 1 else in_processes(work, tasks, workers)


def in_processes(
    work: Callable[[Task], Result], tasks: Iterable[Task], workers: int
) -> Generator[Result, None, None]:
    """The results of the tasks, in their order. `work` is a module's function.

    At most two results per worker wait, so memory does not grow with the number of tasks. An interrupt cancels waiting
    tasks and lets each worker finish its current one.
    """
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_set_up_worker)
    queue = iter(tasks)
    waiting: deque[Future[Result]] = deque(_submit(pool, work, task) for task in islice(queue, 2 * workers))
    try:
        while waiting:
            result = waiting.popleft().result()
            waiting.extend(_submit(pool, work, task) for task in islice(queue, 1))
            yield result
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _submit(pool: ProcessPoolExecutor, work: Callable[[Task], Result], task: Task) -> Future[Result]:
    """Submit a task. A worker that this starts does not hear Ctrl-C, which would end it with a traceback until it is
    set up."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(work, task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _set_up_worker() -> None:
    """Set up a worker: one thread, Ctrl-C left to the parent, and an end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    threadpool_limits(limits=1)
    # A killed parent stops nothing: without this its workers would wait for tasks forever.
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
