"""Says what the contact is at every moment: to the outputs, on the topic `contact`, and as the alarm of an overload."""

from collections import deque
from typing import Final, Self, final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.events import Event, PressSettled
from edge.core.contact.press_detector import GAP_S, Look
from edge.core.contact_guidance import guide
from edge.core.contact_state import OVERLOAD_TIMES, ContactFollower, ContactState
from edge.core.digital_io import StationView
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import NominalContact
from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.messaging.status_payloads import ContactPayload
from edge.model.inspector import Inspector
from edge.press_stage import Mounted, PressStage, StageParts
from edge.store.acts import Act
from edge.store.gel_ledger import GelRecord

__all__ = ["ContactWatch"]

# How often an unchanged state is said again, so that one who hears nothing knows that it is over.
_PRESSED_S: Final = 0.2
_FREE_S: Final = 2.0

# A frame that a driver has kept while this process got no time: another part may lie there now.
_OLD_S: Final = 1.0

# Overloads that wait while the database refuses writes; the newest are kept.
_MOST_WAITING: Final = 64


@final
class ContactWatch(PressStage):
    """Follows the contact of a station's sensor. What has not been seen for `GAP_S` is not known."""

    def __init__(self, parts: StageParts) -> None:
        self.follower = ContactFollower()
        self._parts, self._clock = parts, parts.clock
        self._taken_ns = self._seen_ns = parts.clock.monotonic_ns()
        self._lost_ns: int | None = None
        self._is_ready = False
        self._look: Look | None = None
        self._contact: NominalContact | None = None
        self._reach: NDArray[np.bool_] | None = None
        self._said: ContactState | None = None
        self._said_ns = 0
        self._is_overloaded = False
        self._overloads = 0
        self._waiting: deque[Act] = deque(maxlen=_MOST_WAITING)

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts)

    def close(self) -> None:
        self._is_ready = False
        self._say()

    def use(self, inspector: Inspector) -> None:
        manifest = inspector.bundle.manifest
        self.follower.nominal, self._contact = manifest.strength, manifest.contact
        self._reach = _place_reach(inspector)

    def take(self, frame: CameraFrame) -> None:
        """Tell frames of now from those that waited while nobody looked: what these show ends no loss."""
        now_ns = self._clock.monotonic_ns()
        oldest_ns = max(now_ns - round(_OLD_S * 1e9), self._lost_ns or 0)
        self._taken_ns = now_ns if frame.is_on_demand or frame.timestamp_ns >= oldest_ns else 0

    def see(self, event: Event) -> None:
        """Say at once that a press rests. What else an event means is said with the look at its frame."""
        self.follower.see(event)
        if isinstance(event, PressSettled):
            self._say()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        self.follower.judge(press.press_id)
        return press

    def look(self, look: Look) -> None:
        if look.sight.seen_ns == look.timestamp_ns:
            self._seen_ns = self._taken_ns  # a score may have taken long since, and nobody has looked
        self.follower.look(look)
        self._lose_unseen()
        if look.seen is not None:
            self._look = look
        self._watch_overload()
        self._say()

    def record(self, press: Press, gel: GelRecord) -> None:
        self._lose_unseen()
        self.follower.record(press.press_id)
        self._say()

    def show(self, view: StationView) -> None:
        """Nobody has looked since a turn that waited, as for a locked database: `lift` is not of now any more."""
        self._is_ready = view.state == "ready"
        self._lose_unseen()
        self._say()

    def turn(self, mounted: Mounted | None) -> None:
        """Notice that frames have ended, and record overloads. Errors: StoreError; they go on waiting."""
        self._lose_unseen()
        while self._waiting:
            self._parts.store.begin_act(self._waiting[0])
            self._waiting.popleft()

    def _lose_unseen(self) -> None:
        now_ns = self._clock.monotonic_ns()
        if now_ns - self._seen_ns <= GAP_S * 1e9:
            self._lost_ns = None
            return
        self._lost_ns = self._lost_ns or now_ns
        self.follower.lose()
        self._say()

    def _watch_overload(self) -> None:
        """Raise the alarm at the first frame; only a gel that is seen free ends it."""
        follower = self.follower
        if follower.state == "overload" and not self._is_overloaded:
            self._is_overloaded, self._overloads = True, self._overloads + 1
            share = round(follower.depth_share or 0.0, 2)
            given = {"depth_share": share}
            act = Act(self._clock.time_ns(), "the gateway", "overload", arguments=given, outcome="done")
            self._waiting.append(act)
            self._parts.alarms.say(
                "gel_overload",
                Sentence(
                    f"the imprint is more than {OVERLOAD_TIMES:g} times as strong as the strongest at fit, about "
                    f"{share:g} times as deep as usual: the gel may be cut; {self._overloads} since the start. Take "
                    "the part off"
                ),
            )
        elif follower.state == "free" and self._is_overloaded:
            self._is_overloaded = False
            self._parts.alarms.say("gel_overload", None)

    def _say(self) -> None:
        """Tell the outputs, and publish a change at once; what stays is said again from time to time."""
        follower = self.follower
        self._parts.alarms.show_contact(follower.state)
        state: ContactState = follower.state if self._is_ready else "unknown"
        now_ns = self._clock.monotonic_ns()
        pause_s = _FREE_S if state in ("free", "unknown") else _PRESSED_S
        if state == self._said and now_ns - self._said_ns < pause_s * 1e9:
            return
        self._said, self._said_ns = state, now_ns
        self._parts.announce(self._payload(state).message())

    def _payload(self, state: ContactState) -> ContactPayload:
        look, share = self._look, self.follower.depth_share
        if state == "unknown" or look is None or look.seen is None:
            return ContactPayload(time_ns=self._clock.time_ns(), state=state)
        guidance = guide(state, look, self._contact, self._reach)
        return ContactPayload(
            time_ns=self._clock.time_ns(),
            state=state,
            depth_share=None if share is None else round(share, 3),
            frame=look.seen.sequence,
            press_id=self.follower.press_id,
            guidance=None if guidance is None else guidance.advice,
            direction_deg=None if guidance is None else guidance.direction_deg,
        )


def _place_reach(inspector: Inspector) -> NDArray[np.bool_] | None:
    """Where nominal presses reach, bool (120, 160); None where that is not known, or parts lie anywhere."""
    bundle = inspector.bundle
    if inspector.expected is None or bundle.registration is not None:
        return None
    width, height = bundle.profile.size
    whole, region = np.zeros((height, width), np.uint8), bundle.region
    rows, columns = slice(region.y, region.y + region.height), slice(region.x, region.x + region.width)
    whole[rows, columns] = inspector.expected
    return np.asarray(cv2.resize(whole, VIEW_SIZE, interpolation=cv2.INTER_NEAREST) > 0, np.bool_)
