"""A second, equal sensor at the same USB; whoever opened it would judge parts that are pressed on the first."""

import random
from typing import TYPE_CHECKING

from edge.core.errors import DeviceLost, DeviceStalled
from edge.core.imaging.frames import CameraFrame
from simulation.hand import pictures

if TYPE_CHECKING:
    from simulation.schedule import Simulation
    from simulation.sensor import Sensor


class OpenSecond:
    """An opening of it. It shows a sound part whenever one lies on the first."""

    def __init__(self, sensor: "Sensor") -> None:
        self._sensor, self.identity = sensor, sensor.identify_second()
        self._read_ns = self._sequence = 0

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


def plug_second(run: "Simulation", rng: random.Random) -> float:
    """A second sensor is plugged in for a while; sometimes the first is unplugged meanwhile, or the service starts
    again. A station that names its own by serial sees nothing of that (docs/operations.md, Two sensors)."""
    from simulation.faults import stop

    sensor, is_named = run.world.sensor, run.chosen.has_serial
    if sensor.has_second or run.station.loop.session is None:
        return -1.0
    sensor.has_second, lasts_s = True, rng.choice((2.0, 6.0, 15.0))
    what = rng.choice(("stays", "stays", "first is unplugged", "restart"))

    def unplug() -> None:
        sensor.has_second = False

    def plug() -> None:
        sensor.is_plugged = True
        sensor.forget()

    run.for_a_while("second sensor", lasts_s, unplug, is_sensors=not is_named)
    run.reach(f"a second sensor was beside {'one that is named' if is_named else 'any'}, {what}")
    if what == "first is unplugged" and sensor.is_plugged and "sensor unplugged" not in run.ending:
        sensor.is_plugged = False
        sensor.forget()
        run.for_a_while("sensor unplugged", lasts_s / 2, plug, is_sensors=True)
    elif what == "restart" and sensor.is_plugged:
        stop(run, rng)
    return lasts_s
