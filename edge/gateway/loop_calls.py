"""Calls of other threads, done by the station's loop between two frames, so that only the loop changes its state.

The loop may be 0.8 s of frames behind, so calls and frames are taken in the order of their times: whoever asked, a
frame that came before a request never answers it, and a press that was over is of the part, piece and gel before it.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, Generic, TypeVar

from edge.core.errors import GelgateError
from edge.core.ports import Clock

__all__ = ["LoopCalls"]

T = TypeVar("T")
C = TypeVar("C")

# The loop checks for calls five times a second. Without an answer in this time it hangs in a detector or on a disk.
ANSWER_S: Final = 5.0


class LoopCalls(Generic[C]):
    """The calls of other threads, which use `ask` or `post`; the loop uses `serve` and `close`.

    A call gets the argument of `serve`: the loop's own state, which no other thread may use.
    """

    def __init__(self, clock: Clock, answer_s: float = ANSWER_S) -> None:
        self._clock, self._answer_s = clock, answer_s
        self._waiting: deque[tuple[int, Callable[[C], object]]] = deque()
        """The calls, each with the time at which it came, monotonic."""
        self._lock = threading.Lock()
        self._is_closed = False

    def ask(self, do: Callable[[C], T]) -> T:
        """Let the loop call `do`, and return its result. A call that is refused here is not done later.

        Errors: GelgateError when the loop does not answer in time, or has ended; every exception of `do`.
        """
        future: Future[T] = Future()

        def done(state: C) -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(do(state))
            except BaseException as error:  # noqa: BLE001 - it is raised again in the caller's thread
                future.set_exception(error)

        with self._lock:
            if self._is_closed:
                raise GelgateError("the station is ending; ask again when it runs")
            self._waiting.append((self._clock.monotonic_ns(), done))
        try:
            return future.result(self._answer_s)
        except TimeoutError:
            if not future.cancel():
                return future.result()  # started, so it will be done
            raise GelgateError(
                f"the station did not answer within {self._answer_s:g} s, and has not done it; see its state"
            ) from None

    def post(self, do: Callable[[C], object]) -> None:
        """Let the loop call `do`, without waiting for it. After the end it is not called. `do` handles its errors."""
        with self._lock:
            if not self._is_closed:
                self._waiting.append((self._clock.monotonic_ns(), do))

    def serve(self, state: C, before_ns: float = math.inf) -> None:
        """Do the waiting calls that came before that time, which is that of the frame to be looked at next."""
        while self._waiting and self._waiting[0][0] < before_ns:
            self._waiting.popleft()[1](state)

    def close(self, state: C) -> None:
        """Accept no more calls and do those that wait. May be called again."""
        with self._lock:
            self._is_closed = True
        self.serve(state)
