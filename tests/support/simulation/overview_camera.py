"""An overview camera that sees the code of a part before its press, with its faults, and the plugin that opens it."""

import random
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DeviceLost, DeviceNotFound, DeviceStalled
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock, DeviceIdentity, DiscoveredDevice
from simulation.hand import Hand
from simulation.options import NoOptions

if TYPE_CHECKING:
    from simulation.schedule import Simulation
    from simulation.surroundings import SimulatedClock

S = 10**9
PERIOD_NS = S // 15
MAX_AGE_S = 2.0
"""An older still says nothing of a press (docs/operations.md)."""
TABLE = f"""
[overview]
plugin = "simulated"
codes = ["apriltag"]
parts = {{ 0 = "PZ0", 1 = "PZ1" }}
select = true
max_age_s = {MAX_AGE_S}
"""


@cache
def draw_part(number: int) -> NDArray[np.uint8]:
    """Draw a table with a part that has this AprilTag, uint8 (150, 200)."""
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = np.full((150, 200), 110, np.uint8)
    picture[17:125, 46:154] = 235
    picture[31:111, 60:140] = cv2.aruco.generateImageMarker(tags, number, 80)
    return picture


class OverviewCamera:
    """A camera above the hand. mood: `up`, `unplugged`, `silent`, `frozen` (the same picture again) or `broken` (half a
    picture)."""

    now: ClassVar["OverviewCamera"]
    """That of the run that is on."""
    identity = DeviceIdentity("overview camera", "OVER0001", (200, 150), S / PERIOD_NS)

    def __init__(self, clock: "SimulatedClock", hand: Hand, parts: Sequence[str]) -> None:
        self._clock, self._hand, self._parts = clock, hand, parts
        self.mood = "up"
        self.next_ns = clock.now_ns
        self.troubles: list[tuple[int, int]] = []
        """From when to when it was not well; of one that is not over, far in the future."""
        self._made = 0
        self._last = b""

    def go(self, mood: str) -> None:
        """Take this mood."""
        if self.mood == "up":
            self.troubles.append((self._clock.now_ns, 1 << 62))
        self.mood = mood

    def mend(self) -> None:
        """It is plugged in, and sees."""
        if self.mood != "up":
            self.troubles[-1] = self.troubles[-1][0], self._clock.now_ns
        self.mood = "up"

    def was_troubled(self, first_ns: int, last_ns: int) -> bool:
        """Tell whether it was not well at some moment between these."""
        return any(began_ns <= last_ns and first_ns <= ended_ns for began_ns, ended_ns in self.troubles)

    def was_blind(self, first_ns: int, last_ns: int) -> bool:
        """Tell whether it was not well all the time from one to the other."""
        return any(began_ns <= first_ns and last_ns <= ended_ns for began_ns, ended_ns in self.troubles)

    def read(self, deadline_ns: int) -> CameraFrame:
        """Return the newest picture; it waits for none, for the schedule does."""
        if self.mood == "unplugged":
            raise DeviceLost("the overview camera was unplugged")
        if self.mood == "silent" or self._clock.now_ns < self.next_ns:
            raise DeviceStalled("no picture yet")
        self.next_ns = self._clock.now_ns + PERIOD_NS
        self._made += 1
        if self.mood != "frozen" or not self._last:
            self._last = self._picture()
        payload = self._last[: len(self._last) // 2] if self.mood == "broken" else self._last
        return CameraFrame(payload, self._clock.now_ns, self._made)

    def _picture(self) -> bytes:
        picture = draw_part(self._parts.index(self._hand.part)).copy()
        for bit in range(16):  # noise, which never comes again
            picture[144:148, 4 + 6 * bit : 8 + 6 * bit] += np.uint8(10 * (self._made >> bit & 1))
        return cv2.imencode(".jpg", picture)[1].tobytes()

    def close(self) -> None:
        """Nothing is held."""


class OverviewPlugin:
    """The camera of the run."""

    Options = NoOptions

    def discover(self, options: NoOptions) -> Sequence[DiscoveredDevice]:
        camera = OverviewCamera.now
        here = camera.mood != "unplugged"
        return [DiscoveredDevice("simulated", camera.identity.product, camera.identity)] if here else []

    def open(self, options: NoOptions, clock: Clock) -> OverviewCamera:
        if OverviewCamera.now.mood == "unplugged":
            raise DeviceNotFound("no overview camera is plugged in")
        return OverviewCamera.now


def disturb_overview(run: "Simulation", rng: random.Random) -> float:
    """The overview camera is unplugged, hangs, or gives broken pictures."""
    camera, mood = run.world.overview, rng.choice(("unplugged", "silent", "frozen", "broken"))
    if camera is None or camera.mood != "up":
        return 60.0 if camera is None else -1.0
    camera.go(mood)
    return run.for_a_while(f"overview {mood}", rng.choice((0.5, 2.5, 6.0, 12.0)), camera.mend)


overview_plugin = OverviewPlugin()
