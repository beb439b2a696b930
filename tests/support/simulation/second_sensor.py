"""A second, equal sensor at the same USB; whoever opened it would judge parts that are pressed on the first."""

from typing import TYPE_CHECKING

from edge.core.errors import DeviceLost, DeviceStalled
from edge.core.imaging.frames import CameraFrame
from simulation.hand import pictures

if TYPE_CHECKING:
    from simulation.sensor import Sensor


class OpenSecond:
    """An opening of it. It shows a sound part whenever one lies on the first."""

    def __init__(self, sensor: "Sensor") -> None:
        self._sensor, self.identity = sensor, sensor.identify_second()
        self._read_ns = self._sequence = 0
        sensor.is_other_taken |= sensor.is_plugged

    def read(self, deadline_ns: int) -> CameraFrame:
        """Return a picture of now."""
        sensor, now_ns = self._sensor, self._sensor.next_ns - self._sensor.period_ns
        if not sensor.has_second:
            raise DeviceLost("the second sensor was unplugged")
        if now_ns <= self._read_ns:
            raise DeviceStalled("no frame yet")
        self._read_ns, self._sequence = now_ns, self._sequence + 1
        sensor.others.append(now_ns)
        shown = pictures((sensor.hand.depth, "sound"))
        return CameraFrame(shown[self._sequence % len(shown)], now_ns, self._sequence)

    def close(self) -> None:
        """Nothing is held."""
