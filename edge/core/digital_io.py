"""Pedals, lights and relays: their ports, what a station shows, and the rule of one output."""

from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol, get_args, runtime_checkable

from edge.core.contact_state import ContactState

__all__ = [
    "LOOP_S",
    "VERDICTS",
    "Actuator",
    "Condition",
    "DiscoveredPort",
    "OutputRule",
    "StationView",
    "Trigger",
]

State = Literal["starting", "ready", "halted", "stopped"]
Word = Literal["pass", "fail", "unsure", "rejected", "error"]
Condition = Literal[State, Word, ContactState, "alarm", "gel"]
"""What an output can show: a state of the station, the verdict on the last press, the contact, any alarm, a gel that is
due."""

VERDICTS: Final[tuple[str, ...]] = get_args(Word)

# Without a sign of life for this time the loop hangs, and judges nothing.
LOOP_S: Final = 5.0
# As with the messages of a contact: what the loop said longer ago may be of another part.
_FRESH_NS: Final = 1_000_000_000


@dataclass(frozen=True)
class DiscoveredPort:
    """A trigger or an actuator that a plugin found, or something similar that is refused."""

    place: str
    """Where it is, such as `/dev/hidraw3`."""
    product: str
    serial: str | None = None
    """None where it has none."""
    refusal: str | None = None
    """Why it cannot be opened."""


@runtime_checkable
class Trigger(Protocol):
    """An open pedal or button. One thread uses it."""

    @property
    def name(self) -> str:
        """Such as `PCsensor FootSwitch at /dev/hidraw3`."""

    def read(self, deadline_ns: int) -> bool | None:
        """True when it went down, False when it was released, None when neither happened until the deadline.

        Each change is returned once. A vanished device may read as unchanged. Errors: DeviceLost.
        """

    def is_present(self) -> bool:
        """Tell whether it is still plugged in."""

    def close(self) -> None:
        """Release it. May be called again."""


@runtime_checkable
class Actuator(Protocol):
    """An open relay board, light or buzzer: `channels` outputs, numbered from 1. One thread uses it."""

    @property
    def name(self) -> str: ...

    @property
    def channels(self) -> int: ...

    def write(self, channel: int, is_on: bool) -> None:
        """Switch, and return when it is switched. Errors: DeviceLost, DeviceStalled when it does not switch;
        ValueError for a channel that it does not have."""

    def is_present(self) -> bool:
        """Tell whether it is still plugged in."""

    def close(self) -> None:
        """Release it, and leave the outputs as they are. May be called again."""


@dataclass(frozen=True)
class OutputRule:
    """One output of an actuator. All times in nanoseconds."""

    channel: int
    when: frozenset[str]
    """The conditions that switch it on."""
    safe: bool = False
    """Its level in a state that is not named in `when`, except `ready`."""
    pulse_ns: int | None = None
    """On for this time after a verdict, instead of until the next one; the pulse starts within `deadline_ns` of the
    judged frame, or not at all."""
    deadline_ns: int | None = None
    blink_ns: int | None = None
    """On and off for this time each."""

    def __post_init__(self) -> None:
        if self.channel < 1:
            raise ValueError(f"channels are numbered from 1, found {self.channel}")
        if not self.when:
            raise ValueError(f"the output on channel {self.channel} names nothing that switches it on")
        if (self.pulse_ns is None) != (self.deadline_ns is None):
            raise ValueError(f"the output on channel {self.channel} has a pulse and a deadline, or neither")
        if self.pulse_ns is None:
            return
        if self.safe or self.blink_ns is not None:
            raise ValueError(f"the pulse on channel {self.channel} starts from off: no `safe`, no blinking")
        if others := sorted(self.when - set(VERDICTS)):
            raise ValueError(
                f"the pulse on channel {self.channel} follows a verdict ({', '.join(VERDICTS)}), "
                f"found {', '.join(others)}"
            )

    @property
    def passed_over(self) -> tuple[str, ...]:
        """Verdicts besides `pass` that a pulse at `fail` leaves out: as a reject gate it lets these parts through."""
        if self.pulse_ns is None or "fail" not in self.when:
            return ()
        return tuple(word for word in VERDICTS if word != "pass" and word not in self.when)


@dataclass(frozen=True)
class StationView:
    """What outputs show."""

    state: State = "starting"
    verdict: str | None = None
    """The verdict of the last press; None before the first one and after an acknowledgement."""
    alarms: frozenset[str] = frozenset()
    contact: ContactState = "unknown"
    piece_id: str | None = None
    """The piece of several places that is in progress; None where none is."""

    def after(self, silent_ns: int) -> "StationView":
        """Return what is still so where the loop has said nothing for that time: no contact is known then, and no pass
        is shown."""
        if silent_ns <= _FRESH_NS:
            return self
        return replace(self, contact="unknown", verdict=None if self.verdict == "pass" else self.verdict)

    def conditions(self) -> frozenset[str]:
        """Every condition that is true now. A verdict and the contact count only while the station inspects."""
        true_conditions = {self.state, *(["alarm"] if self.alarms else []), *(self.alarms & {"gel"})}
        if self.state == "ready" and self.verdict is not None:
            true_conditions.add(self.verdict)
        true_conditions.add(self.contact if self.state == "ready" else "unknown")
        return frozenset(true_conditions)
