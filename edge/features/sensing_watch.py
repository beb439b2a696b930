"""Says when the station does not sense: the sensor shows nothing, or something holds its contact open."""

import logging
from collections import deque
from datetime import datetime
from typing import Final, Self, final

from edge.core.contact.events import Event, PressBegan, PressEnded, ReferenceReady
from edge.core.contact.press_detector import Look
from edge.core.contact.sight import BLIND_AFTER_S, LongContact, Sight
from edge.core.ports import Clock
from edge.core.sentence import Sentence
from edge.press_stage import Alarms, Mounted, PressStage, StageParts
from edge.store.acts import Act
from edge.store.press_store import Store

__all__ = ["SensingWatch"]

log = logging.getLogger(__name__)

_MERGED: Final = (
    "the gel was pressed: where the part was lifted and another one pressed in that time, or just after it, both are "
    "one press"
)

# Two seconds of the free gel are enough to learn it.
_LEARNT_AFTER_S: Final = 15.0
_NOT_LEARNT: Final = Sentence(
    f"the free gel was not seen at rest for more than {_LEARNT_AFTER_S:.0f} s, so presses are not seen and not "
    "counted; lift the part for two seconds"
)

# Times without sight that wait while the database refuses writes; the newest are kept.
_MOST_WAITING: Final = 256


@final
class SensingWatch(PressStage):
    """Follows the frames and the contact events of one sensor, and raises the alarms `device` and `contact`.

    The pass light goes out earlier, in `edge.features.outputs.stage`.

    A time in which nothing was seen, without frames or blind, is over with the next frame that shows the gel. It is
    then an act of the gateway, for presses may have been made in it; one that a start falls into is counted from the
    first frame on. A shorter interruption is one, the first of each press, while the gel is pressed: another part may
    have taken the place of the first.
    """

    def __init__(self, alarms: Alarms, store: Store, clock: Clock) -> None:
        self._alarms, self._store, self._clock = alarms, store, clock
        self._contact = LongContact()
        self._blind: Sentence | None = None
        self._seen_ns: int | None = None  # or of the first frame, until one has shown the gel
        self._unseen: deque[Act] = deque(maxlen=_MOST_WAITING)
        self._is_pressed = False  # and the press has not been interrupted
        self._is_learning = True  # the picture of the free gel
        self._learning_ns: int | None = None  # since when it is seen

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts.alarms, parts.store, parts.clock)

    def see(self, event: Event) -> None:
        if isinstance(event, PressBegan):
            self._contact.begin(event.timestamp_ns)
            self._is_pressed = True
        elif isinstance(event, PressEnded):
            self._contact.end(event.timestamp_ns)
            self._is_pressed = False
        elif isinstance(event, ReferenceReady):
            self._is_learning = False

    def relearn(self) -> None:
        """The picture of the free gel is learnt again."""
        self._is_learning, self._learning_ns = True, None

    def look(self, look: Look) -> None:
        sight, timestamp_ns = look.sight, look.timestamp_ns
        if self._seen_ns is None:
            self._seen_ns = timestamp_ns
        self._contact.leave_out(look.interruption_s, timestamp_ns)
        self._contact.see(look.phase)
        if is_merged := look.interruption_s > 0 and self._is_pressed:
            self._is_pressed = False
            log.warning("nothing was seen for %.1f s; %s", look.interruption_s, _MERGED)
            self._note(look.interruption_s, _MERGED)
        if sight.seen_ns == timestamp_ns:
            if not is_merged:
                self._note_unseen((timestamp_ns - self._seen_ns) / 1e9)
            self._seen_ns = timestamp_ns
        if self._learning_ns is None or sight.lost or look.interruption_s > BLIND_AFTER_S:
            self._learning_ns = timestamp_ns
        if sight.lost is None:
            is_late = self._is_learning and timestamp_ns - self._learning_ns > _LEARNT_AFTER_S * 1e9
            sentence, is_fault = (_NOT_LEARNT, False) if is_late else self._contact.look(timestamp_ns)
            if self._alarms.set_fault("contact", sentence if is_fault else None):
                log.error("%s", sentence)
            if not is_fault:
                self._alarms.say("contact", sentence, "error" if is_late else "warning")
        if (self._blind is None) != (sight.lost is None):
            self._blind = None if sight.lost is None else self._sentence(sight, timestamp_ns)
            log.warning("%s", self._blind or "the sensor shows its gel again")
            self._alarms.set_blind(self._blind)

    def turn(self, mounted: Mounted | None) -> None:
        """Record the times in which nothing was seen. Errors: StoreError; they go on waiting."""
        while self._unseen:
            self._store.begin_act(self._unseen[0])
            self._unseen.popleft()

    def _note_unseen(self, seconds: float) -> None:
        if seconds > BLIND_AFTER_S:
            self._note(seconds, self._blind or "no frames came")

    def _note(self, seconds: float, why: str) -> None:
        arguments = {"seconds": round(seconds, 1), "why": why}
        act = Act(self._clock.time_ns(), "the gateway", "not_seen", arguments=arguments, outcome="done")
        self._unseen.append(act)

    def _sentence(self, sight: Sight, timestamp_ns: int) -> Sentence:
        if sight.comes_and_goes:
            return Sentence(
                "the sensor's picture comes and goes, and presses are neither judged nor counted while it is gone: "
                f"then {sight.lost}. Check its cable, its light and its gel"
            )
        ago_ns = timestamp_ns - (sight.since_ns if sight.since_ns is not None else timestamp_ns)
        since = datetime.fromtimestamp((self._clock.time_ns() - ago_ns) / 1e9).astimezone()
        return Sentence(
            f"the sensor is blind: nothing was seen since {since:%H:%M:%S}, and presses since then are neither judged "
            f"nor counted; for {BLIND_AFTER_S:.0f} s {sight.lost}. Check its light and gel, then plug it in again"
        )
