"""A process whose files may not grow: the nearest to a full disk that needs no rights."""

import os
import pickle
import resource
from collections.abc import Callable
from typing import Any

from edge.core.errors import GelgateError

__all__ = ["with_room_for"]


def with_room_for(size: int, act: Callable[[], Any]) -> Any:
    """What `act` returns in a forked process, no file of which may grow beyond `size` bytes; its error is raised here.

    A process of its own, since the limit holds for every thread, those of the test runner too.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _report(writing, size, act)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        is_error, value = pickle.load(answer)
    os.waitpid(child, 0)
    if is_error:
        raise value
    return value


def _report(writing: int, size: int, act: Callable[[], Any]) -> None:
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        try:
            result = (False, act())
        except (GelgateError, OSError) as error:
            result = (True, error)
        with os.fdopen(writing, "wb") as answer:
            pickle.dump(result, answer)
    finally:
        os._exit(0)
