"""The last day of use of the mounted gel: an alarm after it, also when the station starts later."""

from typing import Final, Self

from edge.clock import local_day
from edge.core.gel_life import is_past
from edge.core.ports import Clock
from edge.core.sentence import Sentence
from edge.press_stage import Alarms, Mounted, PressStage, StageParts
from edge.store.gel_ledger import GelRecord

__all__ = ["GelDateWatch"]

LOOK_S: Final = 1.0
# The alarm ends by the clock when that has shown an earlier day for this long: a clock that steps forward and back
# around midnight, or an hour back at the end of summer time, does not end it.
EARLIER_S: Final = 2 * 3600


class GelDateWatch(PressStage):
    """Compares the date of the gel with the local day of this machine. Presses are judged as before."""

    def __init__(self, alarms: Alarms, clock: Clock) -> None:
        self._alarms, self._clock = alarms, clock
        self._gel: GelRecord | None = None
        self._ends_ns = 0  # of the alarm
        self._next_look_ns = 0

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts.alarms, parts.clock)

    def mount(self, gel: GelRecord) -> None:
        """Another gel has another date, or none."""
        self._gel, self._next_look_ns = gel, 0
        self._alarms.say("gel_expired", None)

    def turn(self, mounted: Mounted | None) -> None:
        """Look now and then."""
        gel, now_ns = self._gel, self._clock.monotonic_ns()
        if gel is None or now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + round(LOOK_S * 1e9)
        if is_past(gel.use_by, local_day(self._clock.time_ns())):
            self._ends_ns = now_ns + EARLIER_S * 10**9
            self._alarms.say(
                "gel_expired", Sentence(f"gel {gel.gel_id} is past its use-by date {gel.use_by}"), "warning"
            )
        elif now_ns >= self._ends_ns:
            self._alarms.say("gel_expired", None)
