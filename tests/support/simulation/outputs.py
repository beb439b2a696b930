"""A relay board and a pedal, each with a state of its own, and what was switched when."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceLost, DeviceNotFound, DeviceStalled
from edge.core.ports import Clock
from simulation.options import NoOptions

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

S = 10**9
LAMP, REJECT, GATE, LIFT, FREE, OVERLOAD = 1, 2, 3, 4, 5, 6
TREADS_S = 0.35
"""So long a person holds a pedal down."""
PLUGGED_S = 8.0
"""A pedal that is plugged in is opened so soon."""
DEADLINE_S, PULSE_S = 0.5, 0.2
"""Of both pulses: a part that fails is thrown out, one that passes is let through."""

TABLES = f"""
[[actuators]]
plugin = "simulated"
outputs = [
  {{ channel = {LAMP}, when = ["pass"] }},
  {{ channel = {REJECT}, when = ["fail", "unsure", "rejected", "error"], pulse_ms = {1000 * PULSE_S}, deadline_ms = {1000 * DEADLINE_S} }},
  {{ channel = {GATE}, when = ["pass"], pulse_ms = {1000 * PULSE_S}, deadline_ms = {1000 * DEADLINE_S} }},
  {{ channel = {LIFT}, when = ["lift"] }},
  {{ channel = {FREE}, when = ["free"] }},
  {{ channel = {OVERLOAD}, when = ["overload"] }},
]
[[triggers]]
plugin = "simulated"
action = "acknowledge"
"""  # noqa: E501


@dataclass(frozen=True)
class Switching:
    """A channel that was switched on, and when the board was told."""

    channel: int
    told_ns: int


class Relay:
    """A board with relays. mood: `up`, `unplugged`, `slow` or `stuck`. is_open: not unplugged since it was opened; what
    was is another device to the system, however soon it is back."""

    now: ClassVar["Relay"]
    """That of the run that is on."""
    name = "simulated relay"
    channels = OVERLOAD

    def __init__(self, clock: "SimulatedClock", is_dead: Callable[[], bool], rng: random.Random) -> None:
        self._clock, self._is_dead, self._rng = clock, is_dead, rng
        self.mood, self.is_open = "up", False
        self.well_since_ns = 0
        self.is_on = dict.fromkeys((LAMP, REJECT, GATE, LIFT, FREE, OVERLOAD), False)
        self.switched: list[Switching] = []
        self.told: list[Switching] = []
        """And those that it was told to switch on, also where they were on."""

    def mend(self) -> None:
        """It is plugged in, and switches at once. Some boards begin as they were, others anyhow."""
        self.is_open &= self.mood != "unplugged"
        if self.mood == "unplugged" and self._rng.random() < 0.8:
            self.is_on = {channel: self._rng.random() < 0.5 for channel in self.is_on}
        self.mood, self.well_since_ns = "up", self._clock.now_ns

    def write(self, channel: int, is_on: bool) -> None:
        told_ns = self._clock.now_ns
        if not self.is_present() or self._is_dead():
            raise DeviceLost("the relay was unplugged")
        if self.mood == "stuck":
            raise DeviceStalled("the relay does not switch")
        if self.mood == "slow":
            self._clock.now_ns += S // 10
        if is_on:
            self.told.append(Switching(channel, told_ns))
        if is_on and not self.is_on[channel]:
            self.switched.append(Switching(channel, told_ns))
        self.is_on[channel] = is_on

    def is_present(self) -> bool:
        return self.is_open and self.mood != "unplugged"

    def close(self) -> None:
        """The relays stay as they are."""


class Pedal:
    """A pedal. mood: `up`, `unplugged`, `stuck` (held down) or `trodden` (down and up again and again)."""

    now: ClassVar["Pedal"]
    """That of the run that is on."""
    name = "simulated pedal"

    def __init__(self, clock: "SimulatedClock") -> None:
        self._clock = clock
        self.mood, self.well_since_ns = "up", 0
        self._down_until_ns = 0
        self._was_down = False

    def mend(self) -> None:
        """It is plugged in, and nobody treads on it."""
        self.mood, self.well_since_ns = "up", self._clock.now_ns

    def step_on(self) -> None:
        """Somebody treads on it, once."""
        self._down_until_ns = self._clock.now_ns + round(TREADS_S * S)

    @property
    def is_sure(self) -> bool:
        """Who treads on it now is heard: it was plugged in, and nobody trod, since it was opened at the latest."""
        return self.mood == "up" and self._clock.now_ns - self.well_since_ns > PLUGGED_S * S

    def read(self, deadline_ns: int) -> bool | None:
        """Return a change; it waits for none, for the schedule does."""
        if self.mood == "unplugged":
            raise DeviceLost("the pedal was unplugged")
        is_down = self.mood == "stuck" or self._clock.now_ns < self._down_until_ns
        is_down |= self.mood == "trodden" and self._clock.now_ns // (S // 5) % 2 == 0
        was_down, self._was_down = self._was_down, is_down
        return is_down if is_down != was_down else None

    def is_present(self) -> bool:
        return self.mood != "unplugged"

    def close(self) -> None:
        """Nothing is held."""


class RelayPlugin:
    """The board of the run."""

    Options = NoOptions

    def discover(self, options: NoOptions) -> Sequence[DiscoveredPort]:
        return [DiscoveredPort("simulated", Relay.name)] if Relay.now.mood != "unplugged" else []

    def open(self, options: NoOptions, clock: Clock) -> Relay:
        if Relay.now.mood == "unplugged":
            raise DeviceNotFound("no relay is plugged in")
        Relay.now.is_open = True
        return Relay.now


class PedalPlugin:
    """The pedal of the run."""

    Options = NoOptions

    def discover(self, options: NoOptions) -> Sequence[DiscoveredPort]:
        return [DiscoveredPort("simulated", Pedal.name)] if Pedal.now.is_present() else []

    def open(self, options: NoOptions, clock: Clock) -> Pedal:
        if not Pedal.now.is_present():
            raise DeviceNotFound("no pedal is plugged in")
        return Pedal.now


relay_plugin, pedal_plugin = RelayPlugin(), PedalPlugin()
