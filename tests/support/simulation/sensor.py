"""A sensor on USB, with its faults, and the plugin through which the station opens it."""

import random
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from edge.core.errors import DeviceLost, DeviceStalled, FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock, DeviceIdentity, DiscoveredDevice
from plugins.devices.uvc.identity import SensorOnBus, choose
from simulation.hand import SIZE, Hand, pictures
from simulation.options import SensorOptions
from simulation.second_sensor import OpenSecond

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

S = 10**9
BEHIND_S = 0.3
"""A reader that gets its turns has taken a frame by then."""
READ_LATE_S = 0.15
"""So long a frame waits only where a disk holds up who reads it."""
GAP_S, MERGES_S = 0.27, 0.5
"""Frames further apart are an interruption; so soon after it a press may count as that before (docs/contact.md)."""
BEING_LEARNT = "the gel was being learnt"
"""A press that meets this may be lost."""

SERIAL, OTHER_SERIAL = "SIM00001", "SIM00002"


class Sensor:
    """A sensor that makes a frame each period, whether it is read or not, and the hand that presses on it.

    The driver keeps four frames, as those of cameras do: the oldest or the newest.
    """

    now: ClassVar["Sensor"]
    """That of the run that is on."""
    KEPT = 4

    def __init__(
        self, rng: random.Random, clock: "SimulatedClock", fps: float, *, stamps_late: bool = False
    ) -> None:
        self._rng, self._clock, self.stamps_late = rng, clock, stamps_late
        self.period_ns = round(S / fps)
        self.hand = Hand(rng, 1 / fps)
        self.serial = SERIAL
        self.is_plugged = True
        self.is_silent = False
        self.is_frozen = False
        self.is_covered = False
        self.is_holding = False
        """The bus holds what was made, and gives it in a burst."""
        self.jitter_share = 0.0
        self.damage: tuple[str, float] = ("", 0.0)
        """`corrupt`, `truncated` or `broken inside`, and of which share of the frames."""
        self.troubles: set[str] = set()
        """Faults of now: a press that meets one may be lost."""
        self.dim_until_ns = 0
        """Until then a press may count as one with that before the interruption (docs/contact.md)."""
        self.has_second = False
        """An equal one is plugged in too."""
        self.others: list[int] = []
        """The times of frames that the station has read from it."""
        self.is_other_taken = False
        """It has opened the other one of two."""
        self.openings = 0
        self.keeps_oldest = rng.random() < 0.5
        """Of frames that nobody reads; otherwise the newest."""
        self.next_ns = clock.now_ns
        self._made = 0
        self._last = self._given = b""
        self.given = 0
        self._kept: deque[tuple[bytes, int]] = deque()

    @property
    def identity(self) -> DeviceIdentity:
        """Who is on the bus now."""
        fps = round(S / self.period_ns, 2)
        return DeviceIdentity("GelSight Mini R0B SIM0-0001", self.serial, SIZE, fps)

    def identify_second(self) -> DeviceIdentity:
        """Who is beside it."""
        return replace(self.identity, product="GelSight Mini R0B SIM0-0002", serial=OTHER_SERIAL)

    def make(self, is_ready: bool) -> None:
        """The camera makes a frame of what is on the gel now. is_ready: what the person sees of the station."""
        made_ns = self.next_ns
        self.next_ns += round(self.period_ns * (1 + self.jitter_share * self._rng.uniform(-1, 1)))
        phase = self.hand.move(made_ns, is_ready)
        if press := self.hand.press:
            press.why |= self.troubles
            press.is_others &= self.serial != SERIAL and self.is_plugged
            if press.begin_ns < self.dim_until_ns:
                press.why.add("it began just after an interruption")
        if not self.is_plugged or self.is_silent:
            return
        self._kept.append((self._picture(phase), made_ns))
        # Frames in a buffer of a driver that stamps what it reads are few; a bus that gives many late has their times.
        if len(self._kept) > (40 if self.is_holding and not self.stamps_late else self.KEPT):
            self._kept.pop() if self.keeps_oldest else self._kept.popleft()
            self.disturb("frames were dropped")

    def take(self) -> tuple[bytes, int] | None:
        """Take the oldest frame."""
        return self._kept.popleft() if self._kept and not self.is_holding else None

    @property
    def has_frame(self) -> bool:
        """A frame waits for its reader."""
        return bool(self._kept) and not self.is_holding

    @property
    def is_behind(self) -> bool:
        """What waits is older than anything a person does now."""
        return bool(self._kept) and self._clock.now_ns - self._kept[0][1] > BEHIND_S * S

    def note_given(self, payload: bytes) -> None:
        """Count the pictures that the station has read; the same one again is none."""
        self.given += payload != self._given
        self._given = payload

    def forget(self) -> None:
        """What waits is lost: the sensor was unplugged, or is opened anew."""
        self._kept.clear()

    def disturb(self, why: str, after_s: float = 2.5) -> None:
        """Note a fault with the presses of now: those made until a while ago, whose result may be under way."""
        for press in reversed(self.hand.presses[-8:]):
            if not press.end_ns or self._clock.now_ns - press.end_ns < after_s * S:
                press.why.add(why)

    def _picture(self, phase: tuple[float, str]) -> bytes:
        if self.is_frozen and self._last:
            return self._last
        shown = (
            pictures((-1.0, "covered")) if self.is_covered else pictures(phase, is_marked=self.hand.is_marked)
        )
        picture = shown[self._made % len(shown)]
        self._made += 1
        comment = b"\xff\xfe" + (10).to_bytes(2, "big") + self._made.to_bytes(8, "big")
        picture = picture[:2] + comment + picture[2:]
        damage, share = self.damage
        if damage and damage != "corrupt" and self._rng.random() < share:
            self.disturb(f"a frame was {damage}")
            middle = len(picture) // 2
            picture = picture[:middle] if damage == "truncated" else picture[:middle] + picture[-2:]
        self._last = picture
        return picture


class OpenSensor:
    """An opening of the sensor, as the station reads it."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._sequence = self._read_ns = 0
        self.identity = sensor.identity
        self._opening = sensor.openings = sensor.openings + 1
        sensor.forget()
        sensor.dim_until_ns = max(sensor.dim_until_ns, sensor._clock.now_ns + S)

    def read(self, deadline_ns: int) -> CameraFrame:
        """Return the oldest frame; it waits for none, for the schedule does."""
        sensor = self._sensor
        is_same = sensor.openings == self._opening and sensor.serial == self.identity.serial
        if not sensor.is_plugged or not is_same:
            raise DeviceLost("the sensor was unplugged")
        taken = sensor.take()
        if taken is None:
            raise DeviceStalled("no frame yet")
        self._sequence += 1
        payload, made_ns = taken
        if sensor.stamps_late and sensor._clock.now_ns - made_ns > READ_LATE_S * S:
            # By its times the gel is seen free for less long than it was.
            sensor.dim_until_ns = max(sensor.dim_until_ns, sensor._clock.now_ns + round(READ_LATE_S * S))
        # A relay that is slow holds up everybody in this world.
        if sensor.stamps_late and 0 < self._read_ns < sensor._clock.now_ns - GAP_S * S:
            sensor.dim_until_ns = max(sensor.dim_until_ns, sensor._clock.now_ns + round(MERGES_S * S))
        self._read_ns = sensor._clock.now_ns
        sensor.note_given(payload)
        damage, share = sensor.damage
        if damage == "corrupt" and sensor._rng.random() < share:
            sensor.disturb("a frame was corrupt")
            raise FrameCorrupt("a frame ends in the middle")
        return CameraFrame(payload, sensor._clock.now_ns if sensor.stamps_late else made_ns, self._sequence)

    def close(self) -> None:
        """Nothing is held."""


class SensorPlugin:
    """The sensor of the run."""

    Options = SensorOptions

    def discover(self, options: SensorOptions) -> Sequence[DiscoveredDevice]:
        sensor = Sensor.now
        here = [sensor.identity] * sensor.is_plugged + [sensor.identify_second()] * sensor.has_second
        return [DiscoveredDevice(f"simulated {n}", one.product, one) for n, one in enumerate(here)]

    def open(self, options: SensorOptions, clock: Clock) -> OpenSensor | OpenSecond:
        seen = [SensorOnBus(None, one) for one in self.discover(options)]
        chosen = choose(seen, options.serial).discovered.identity
        return OpenSensor(Sensor.now) if chosen == Sensor.now.identity else OpenSecond(Sensor.now)


sensor_plugin = SensorPlugin()
