"""A contact that lasts much longer than the usual ones: what holds it open hides the presses that follow."""

from collections import deque
from statistics import median
from typing import Final, final

__all__ = ["LongContact"]

_CONTACTS_KEPT: Final = 9
# This many times the usual length is an alarm, and twice as long a fault. A station that holds every part for a minute
# is used to it; one that knows no usual length yet has half a minute.
_TIMES: Final = 4.0
_LEAST_S: Final = 3.0
_FIRST_S: Final = 15.0


@final
class LongContact:
    """Follows the contacts of one sensor, by the frames' own times."""

    def __init__(self) -> None:
        self._lengths_s: deque[float] = deque(maxlen=_CONTACTS_KEPT)
        self._began_ns: int | None = None

    def begin(self, timestamp_ns: int) -> None:
        """A press began."""
        self._began_ns = timestamp_ns

    def end(self, timestamp_ns: int) -> None:
        """The gel is free again."""
        if self._began_ns is not None:
            self._lengths_s.append((timestamp_ns - self._began_ns) / 1e9)
        self._began_ns = None

    @property
    def limit_s(self) -> float:
        """The length at which a contact is an alarm; at twice this it is a fault."""
        return max(_TIMES * median(self._lengths_s), _LEAST_S) if self._lengths_s else _FIRST_S

    def look(self, timestamp_ns: int) -> tuple[str | None, bool]:
        """Return what is to be said of the contact now, None while it is of a usual length; and whether it is a
        fault."""
        lasted_s = 0.0 if self._began_ns is None else (timestamp_ns - self._began_ns) / 1e9
        if lasted_s < self.limit_s:
            return None, False
        usual = f", usually {median(self._lengths_s):.1f} s" if self._lengths_s else ""
        # A text that stays the same is published once.
        text = (
            f"something has pressed the gel for more than {self.limit_s:.0f} s{usual}; presses over it are not seen "
            "and not counted. Lift the part and look at the gel: wipe off what stays on it"
        )
        return text, lasted_s >= 2 * self.limit_s
