"""What a robot or a hand beside the sensor needs to know of the contact, after every frame."""

from typing import Final, Literal, final

from edge.core.contact.events import Event, PressBegan, PressEnded, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.contact.signals import Phase
from edge.core.imaging.quality import NominalStrength

__all__ = ["OVERLOAD_TIMES", "Advice", "ContactFollower", "ContactState"]

ContactState = Literal[
    "unknown",
    "free",
    "touching",
    "pressing",
    "deep_enough",
    "at_rest",
    "judged",
    "lift",
    "overload",
]
"""unknown: the station does not see the contact, or cannot say what it belongs to. free: nothing touches. touching:
something does, not yet as a press. pressing, deep_enough: a press that is less deep than those at fit, or as deep.
at_rest: it rests, and its frame is being judged or waits for a trigger. judged: it has a verdict that is not recorded
yet. lift: the verdict is recorded, and the part may be lifted; until the gel is free. overload: the press is far deeper
than those at fit; until the gel is free."""

Advice = Literal["deeper", "shift", "tilt", "hold", "lift"]
"""What a hand should do with the press."""

OVERLOAD_TIMES: Final = 2.0
"""A press of more than this many times the largest strength at fit is an overload."""

# The gateway's reduced views show a twentieth less or more than the pictures of the fit.
_DEEP_SHARE: Final = 0.9
# The strength of an imprint grows faster than its depth.
_DEPTH_POWER: Final = 0.75


@final
class ContactFollower:
    """Follows the contact of one sensor. Feed it each event, then the look; `judge` and `record` come between.

    nominal: of the bundle in use; None where it does not know how deep its presses were: then no press is
    `deep_enough` or an `overload`.
    """

    def __init__(self) -> None:
        self.nominal: NominalStrength | None = None
        self.state: ContactState = "unknown"
        self.depth_share: float | None = None
        """Of the press, as a share of the middle press at fit; None where that is not known, or nothing touches."""
        self.press_id: str | None = None
        """The press that has its verdict and is still held."""
        self._is_recorded = False
        self._is_doubtful = False
        self._is_overloaded = False

    def see(self, event: Event) -> None:
        """Take a contact event. A press begins and ends without a verdict."""
        if isinstance(event, PressBegan | PressEnded):
            self.press_id, self._is_recorded = None, False
        elif isinstance(event, PressSettled) and event.is_held and not self._is_overloaded:
            self.state = "at_rest"  # now, for its score takes a while

    def judge(self, press_id: str) -> None:
        """Take it that the present press has its verdict."""
        self.press_id = press_id
        if self.state == "at_rest":
            self.state = "judged"

    def record(self, press_id: str) -> None:
        """Take it that a press is recorded, perhaps one that is over."""
        if press_id == self.press_id:
            self._is_recorded = True
            if self.state == "judged":
                self.state = "lift"

    def lose(self) -> None:
        """Nothing is seen any more."""
        self.state, self.depth_share = "unknown", None

    def look(self, look: Look) -> None:
        """Take what a frame shows. One that was not decoded tells nothing new."""
        if look.interruption_s > 0 and self.press_id is not None:
            self._is_doubtful = True  # another part may lie on the gel now
        if look.phase == "unseen":
            self.lose()
        elif look.seen is not None:
            self._take(look.phase, look.seen.strength)

    def _take(self, phase: Phase, strength: float) -> None:
        is_free, nominal = phase == "free", self.nominal
        self._is_doubtful |= phase == "over it"
        if is_free:
            self._is_overloaded = False
            # What presses before the press is over continues it, and may be another part.
            self._is_doubtful = self.press_id is not None
        elif nominal is not None and strength > OVERLOAD_TIMES * nominal.highest:
            self._is_overloaded = True
        is_known = nominal is not None and not is_free
        self.depth_share = (strength / nominal.middle) ** _DEPTH_POWER if nominal and is_known else None
        is_deep = nominal is not None and strength >= _DEEP_SHARE * nominal.lowest
        if self._is_overloaded:
            self.state = "overload"
        elif self._is_doubtful and not is_free:
            self.state = "unknown"
        else:
            self.state = self._name(phase, is_deep=is_deep)

    def _name(self, phase: Phase, *, is_deep: bool) -> ContactState:
        match phase:
            case "free" | "touching":
                return phase
            case "pressed":
                return "deep_enough" if is_deep else "pressing"
        if self.press_id is None:
            return "at_rest"
        return "lift" if self._is_recorded else "judged"
