"""One job at a time on a thread of its own: what the station's loop must not wait for."""

import logging
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Background"]

log = logging.getLogger(__name__)

T = TypeVar("T")


class Background(Generic[T]):
    """Does a job that is asked for, and keeps its outcome until it is taken. One that raises has none: its error is
    in the log.

    close_s: a job that is not done is left after this time. `step` is one turn of the own thread; a test may call it.
    """

    def __init__(self, name: str, close_s: float) -> None:
        self._close_s = close_s
        self._job: Callable[[], T] | None = None
        self._outcome: T | None = None
        self._is_working = self._is_closing = False
        self._exchange = threading.Lock()  # no thread takes what another one has just replaced
        self._asked = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def is_busy(self) -> bool:
        """True while a job waits or is done."""
        return self._is_working or self._job is not None

    def start(self) -> None:
        """Begin to wait for jobs."""
        self._thread.start()

    def ask(self, job: Callable[[], T]) -> None:
        """Do this next, instead of one that still waits."""
        with self._exchange:
            self._job = job
        self._asked.set()

    def take(self) -> T | None:
        """Return the outcome of the last job, once; None while there is none."""
        with self._exchange:
            outcome, self._outcome = self._outcome, None
        return outcome

    def step(self) -> None:
        """Do the job that waits, if there is one."""
        self._is_working = True
        self._asked.clear()
        with self._exchange:
            job, self._job = self._job, None
        try:
            if job is not None:
                outcome = job()
                with self._exchange:
                    self._outcome = outcome
        except Exception as error:  # the thread goes on with the next job
            log.exception("the job of thread '%s' failed: %s", self._thread.name, error)
        finally:
            self._is_working = False

    def close(self) -> None:
        """End the thread. May be called again."""
        self._is_closing = True
        self._asked.set()
        if self._thread.is_alive():
            self._thread.join(self._close_s)

    def _run(self) -> None:
        while not self._is_closing:
            self._asked.wait()
            if not self._is_closing:
                self.step()
