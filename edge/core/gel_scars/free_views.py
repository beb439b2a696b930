"""The free gel between two presses, as a running mean of the last views."""

from typing import final

import numpy as np

from edge.core.contact.reference import View
from edge.core.contact.table import State

__all__ = ["FreeViews"]

# About this many views are averaged: a second of an idle station, whose last ones count most.
_AVERAGED = 10
# Fewer give no picture of the free gel.
_LEAST = 3
# The last views before a press may show its approach.
_HELD_BACK = 2

_FREE = (State.NO_CONTACT, State.RECOVERY)


@final
class FreeViews:
    """Feed every view that is looked at; the mean is of those after the last press. It keeps three views."""

    def __init__(self) -> None:
        self._mean: View | None = None
        self._count = 0
        self._waiting: list[View] = []
        self._was_free = False

    def see(self, state: State, view: View | None) -> None:
        """view: float32 (h, w, 3); None while none is known. state: of the contact table, with this view."""
        is_free = state in _FREE and view is not None
        if not is_free:
            self._waiting.clear()
        else:
            if not self._was_free:
                self._mean, self._count = None, 0
            self._waiting.append(view)  # type: ignore[arg-type]
            if len(self._waiting) > _HELD_BACK:
                self._add(self._waiting.pop(0))
        self._was_free = is_free

    def mean(self) -> View | None:
        """The free gel after the last press, float32 (h, w, 3); None where it was not seen long enough."""
        return self._mean if self._count >= _LEAST else None

    def clear(self) -> None:
        """Forget it: another gel is mounted."""
        self._mean, self._count, self._was_free = None, 0, False
        self._waiting.clear()

    def _add(self, view: View) -> None:
        self._count += 1
        if self._mean is None:
            self._mean = view.copy()
        else:
            self._mean += np.float32(1 / min(self._count, _AVERAGED)) * (view - self._mean)
