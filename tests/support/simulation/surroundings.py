"""What surrounds a station, each with a state of its own; a package of plugins is installed for a run.

So the station opens sensor, brokers, relay and pedal as it opens any other.
"""

import gc
import logging
import random
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge import registry
from edge.core.errors import GelgateError
from edge.core.imaging.frames import CameraFrame
from edge.core.press import Press
from simulation.brokers import Broker
from simulation.bundles import PARTS
from simulation.chosen import AGAIN, OVERVIEW, Chosen
from simulation.configuration import Edited
from simulation.connections import Connections
from simulation.hand import MadePress
from simulation.outputs import LIFT, OVERLOAD, Pedal, Relay
from simulation.overview_camera import OverviewCamera
from simulation.pieces import PieceWorker
from simulation.plc import Plc, Server
from simulation.sensor import SERIAL, S, Sensor
from simulation.shelf import Shelf

WALL_NS = 1_780_000_000 * S
"""What the wall clock says at first."""


class SimulatedClock:
    """The station's time. The wall clock is another one: a person, or a time server, may step it, and it drifts."""

    def __init__(self) -> None:
        self.now_ns = S
        self.wall_ns = WALL_NS
        self.drift = 0.0
        """Seconds that the wall clock gains in a second."""

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time_ns(self) -> int:
        return self.wall_ns + self.now_ns + round(self.drift * self.now_ns)

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * S)


class Selected:
    """What a person has selected or mounted, and when: the truth about each press."""

    def __init__(self, first: str, noticed_s: float) -> None:
        self.wanted, self._noticed_s = first, noticed_s
        self.is_sole = True
        """Nobody else selects."""
        self._changes: list[tuple[int, str | None]] = [(0, first)]

    @property
    def changed_ns(self) -> int:
        """When it was changed last; 0 where nobody knows to what."""
        when, part = self._changes[-1]
        return when if part is not None else 0

    @property
    def last_ns(self) -> int:
        """When it may have been changed last, to whatever."""
        return self._changes[-1][0]

    def select(self, now_ns: int, part: str) -> None:
        """Take a selection that the station has confirmed."""
        self.wanted = part
        self._changes.append((now_ns, part if self.is_sole else None))

    def forget(self, now_ns: int) -> None:
        """A selection that waits may be lost: a restart, or a disk without room."""
        self._changes.append((now_ns, None))

    def settle(self, since_ns: int, part: str | None) -> None:
        """Take what is known since then, or is not, unless it was changed after it."""
        if self._changes[-1][0] <= since_ns and self._changes[-1] != (since_ns, part):
            self._changes.append((since_ns, part))

    def allows(self, press: MadePress, name: str) -> bool:
        """Tell whether a press may be of this."""
        return bool({None, name} & self._may_be(press))

    def is_sure(self, press: MadePress, name: str) -> bool:
        """Tell whether it is of nothing else."""
        return self._may_be(press) == {name}

    def _may_be(self, press: MadePress) -> set[str | None]:
        """Return what was selected at its begin, which is noticed a moment later; None for nobody knows what."""
        before = [part for when, part in self._changes if when <= press.begin_ns][-1]
        soon = (part for when, part in self._changes if 0 < when - press.begin_ns < self._noticed_s * S)
        return {before, *soon}


def count_held() -> Counter[str]:
    """Count the frames and presses in memory, by the name of their type."""
    gc.collect()
    return Counter(type(one).__name__ for one in gc.get_objects() if type(one) in (CameraFrame, Press))


class World:
    """The surroundings of the run that is on."""

    def __init__(self, seed: int, chosen: Chosen) -> None:
        self.held_before = count_held()
        """Of other tests in this process."""
        self.clock = SimulatedClock()
        self.sensor = Sensor.now = Sensor(
            random.Random(f"{seed} sensor"), self.clock, chosen.fps, stamps_late=chosen.stamps_late
        )
        self.hand = self.sensor.hand
        self.hand.is_slow = chosen.is_slow
        self.is_lenient = chosen.is_lenient
        self.hand.takes_dents = chosen.has_heir
        self.is_again = AGAIN in chosen.features
        """A press that would fail asks for another one of its part."""
        names = [f"broker{number}" for number in range(chosen.brokers)]
        self.brokers = {
            name: Broker(name, random.Random(f"{seed} {name}"), self.clock, chosen.level) for name in names
        }
        self.shelf: Shelf
        """The bundles of the run."""
        self.edited = Edited()
        self.is_dead = lambda: False
        self.may_refuse = lambda: False  # what would have to be recorded, or done in time
        self.connections = Connections(self.clock, self.brokers, lambda: self.is_dead())
        self.noticed_s = 0.15 + 2.5 / chosen.fps + chosen.sloth_s
        """A contact is a press so long after its begin at most: docs/contact.md has the times."""
        self.parts = Selected(PARTS[0], self.noticed_s)
        self.gels = Selected(f"{SERIAL}-1", self.noticed_s)
        self.relay = Relay.now = Relay(self.clock, lambda: self.is_dead(), random.Random(f"{seed} relay"))
        if chosen.has_robot:
            self.hand.may_lift = lambda: self.relay.is_on[LIFT] or self.relay.is_on[OVERLOAD]
        self.server = Server.now = Server(self.clock, lambda: self.is_dead(), chosen.plc)
        self.has_plc = bool(chosen.plc) and chosen.trigger == "automatic"
        self.has_pieces = bool(chosen.piece) and chosen.trigger == "automatic"
        self.pieces = Selected("", self.noticed_s)
        """The piece that the person has begun."""
        self.places = Selected("", self.noticed_s)
        """The place at which the person lets the part lie, in a free order; a PLC names it with each trigger."""
        self.places.forget(0)
        if self.has_pieces:
            self.parts.forget(self.clock.now_ns)  # the plan selects the bundle
        self.worker = PieceWorker(random.Random(f"{seed} pieces"), chosen.piece)
        self.plcs: list[Plc] = []
        """That of the cell, and others that came."""
        if self.has_plc:
            self.add_plc(random.Random(f"{seed} plc"), "10.0.0.1", 1)
        self.overview: OverviewCamera | None = None
        if OVERVIEW in chosen.features:
            self.hand.parts, self.parts.is_sole = PARTS, False
            self.hand.take_part()
            self.parts.forget(self.clock.now_ns)  # the code on the part selects
            self.overview = OverviewCamera.now = OverviewCamera(self.clock, self.hand, PARTS)
        self.lacks_files_ns = 0
        """The archive may lack presses of until then: the power was lost, or the disk was full."""
        self.has_lost_power = False
        self.new_gel_ns = -S
        """When the gel was replaced last, or was to be learnt again, as the station has confirmed."""
        self.said: list[str] = []
        """How a stop of the service ended, where it did not end well."""
        self.pedal = Pedal.now = Pedal(self.clock)

    def may_lack_files(self, until_ns: int) -> None:
        """The archive may lack files of presses until then."""
        self.lacks_files_ns = max(self.lacks_files_ns, until_ns)

    def add_plc(self, rng: random.Random, ip: str, first_id: int) -> Plc:
        """Add a PLC, which selects parts and begins pieces."""
        plc = Plc(self.clock, self.server, rng, ip, first_id)
        if self.has_pieces:
            plc.on_piece = self.pieces.settle
        else:
            plc.on_part = self.select_by_plc
        self.plcs.append(plc)
        return plc

    def select_by_plc(self, part: str | None) -> None:
        """Take the part that a trigger names; None where nobody knows whether it was taken. One that cannot be recorded
        is not selected: the result is an error."""
        if part is None or self.may_refuse():
            self.parts.forget(self.clock.now_ns)
        else:
            self.parts.select(self.clock.now_ns, part)


class _Log(logging.Handler):
    """Keeps no line, and so no frame of the camera that an error would hold."""

    def __init__(self, found: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._found = found

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if error is not None and not isinstance(error, GelgateError):
            self._found.append(f"it logged an error that nobody foresaw: {record.getMessage()}: {error!r}")


@contextmanager
def reading_log(found: list[str]) -> Iterator[None]:
    """Note each traceback that the program logs: an error that was caught where it goes on, and is none that gelgate
    names. Nothing else is logged."""
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    root.handlers = [_Log(found)]
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.handlers = handlers
        root.setLevel(level)


def install_plugins(folder: Path) -> Iterator[None]:
    """Install the package of the plugins for a run."""
    info = folder / "simulated-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: simulated\nVersion: 1\n")
    places = {
        "devices": "simulation.sensor:sensor_plugin",
        "overviews": "simulation.overview_camera:overview_plugin",
        "sinks": "simulation.connections:mqtt_plugin",
        "triggers": "simulation.outputs:pedal_plugin",
        "actuators": "simulation.outputs:relay_plugin",
        "handshakes": "simulation.plc:server_plugin",
    }
    lines = (f"[gelgate.{group}]\nsimulated = {place}\n" for group, place in places.items())
    page = "[gelgate.sinks]\nsimulated_page = simulation.web:page_plugin\n"
    (info / "entry_points.txt").write_text("".join(lines).replace("[gelgate.sinks]\n", page))
    sys.path.insert(0, str(folder))
    registry._installed.cache_clear()
    registry._points.cache_clear()
    yield
    sys.path.remove(str(folder))
    registry._installed.cache_clear()
    registry._points.cache_clear()
