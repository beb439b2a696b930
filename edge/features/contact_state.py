"""Says what the contact is at every moment: to the outputs, and to whoever waits for it."""

from typing import Self, final

from edge.core.contact.events import Event, PressSettled
from edge.core.contact.press_detector import GAP_S, Look
from edge.core.contact_state import ContactFollower
from edge.core.ports import Clock
from edge.core.press import Press
from edge.model.inspector import Inspector
from edge.press_stage import Alarms, Mounted, PressStage, StageParts
from edge.store.gel_ledger import GelRecord

__all__ = ["ContactWatch"]


@final
class ContactWatch(PressStage):
    """Follows the contact of a station's sensor. What has not been seen for `GAP_S` is not known."""

    def __init__(self, alarms: Alarms, clock: Clock) -> None:
        self.follower = ContactFollower()
        self._alarms, self._clock = alarms, clock
        self._seen_ns = clock.monotonic_ns()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts.alarms, parts.clock)

    def use(self, inspector: Inspector) -> None:
        self.follower.nominal = inspector.bundle.manifest.strength

    def see(self, event: Event) -> None:
        self.follower.see(event)
        self._say()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        self.follower.judge(press.press_id)
        self._say()
        return press

    def look(self, look: Look) -> None:
        if look.sight.seen_ns == look.timestamp_ns:
            self._seen_ns = self._clock.monotonic_ns()
        self.follower.look(look)
        self._say()

    def record(self, press: Press, gel: GelRecord) -> None:
        self.follower.record(press.press_id)
        self._say()

    def turn(self, mounted: Mounted | None) -> None:
        if self._clock.monotonic_ns() - self._seen_ns > GAP_S * 1e9:
            self.follower.lose()
            self._say()

    def _say(self) -> None:
        self._alarms.show_contact(self.follower.state)
