"""Calls of other threads, done by the station's loop between two frames, so that the loop alone changes things."""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, Generic, TypeVar

from edge.core.errors import GelgateError

__all__ = ["LoopCalls"]

T = TypeVar("T")
C = TypeVar("C")

# The loop looks up five times a second; one that does not answer for so long hangs in a detector or on a disk.
ANSWER_S: Final = 5.0


class LoopCalls(Generic[C]):
    """What other threads want done. `ask` is theirs, `serve` and `close` are the loop's.

    A call gets what `serve` is given: the loop's own state, which nobody else may touch.
    """

    def __init__(self, answer_s: float = ANSWER_S) -> None:
        self._answer_s = answer_s
        self._waiting: deque[Callable[[C], None]] = deque()
        self._lock = threading.Lock()
        self._is_closed = False

    def ask(self, do: Callable[[C], T]) -> T:
        """Have `do` done by the loop, and give what it gives. What is refused here is not done later.

        Errors: GelgateError when the loop does not get to it, or has ended; whatever `do` raises.
        """
        future: Future[T] = Future()

        def done(state: C) -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(do(state))
            except BaseException as error:  # noqa: BLE001 - it is the asker's, and raised there
                future.set_exception(error)

        with self._lock:
            if self._is_closed:
                raise GelgateError("the station is ending; ask again when it runs")
            self._waiting.append(done)
        try:
            return future.result(self._answer_s)
        except TimeoutError:
            if not future.cancel():
                return future.result()  # begun, so it will be done
            raise GelgateError(
                f"the station did not get to it within {self._answer_s:g} s, and has not done it; see its state"
            ) from None

    def serve(self, state: C) -> None:
        """Do what waits."""
        while self._waiting:
            self._waiting.popleft()(state)

    def close(self, state: C) -> None:
        """Take no more; what still waits is done, so that nobody waits for nothing. Harmless when repeated."""
        with self._lock:
            self._is_closed = True
        self.serve(state)
