"""PLCs at the registers or the nodes of a station (docs/plc.md), each with a line that may be cut, and their server."""

import random
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, TypeVar

from edge.core.handshake import Handshake
from edge.core.ports import Clock
from simulation.bundles import PARTS
from simulation.options import NoOptions
from simulation.plc_lines import PORTS, Line, ModbusPort, OpcUaPort

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

S = 10**9
TIMEOUT_S, WATCHDOG_S = 3.0, 1.0
HANDSHAKE = f"""
[handshake]
plugin = "simulated"
timeout_s = {TIMEOUT_S}
watchdog_s = {WATCHDOG_S}
"""
WORDS = ("pass", "fail", "unsure", "rejected", "error", "place")
STEPS = ("ready", "ask", "trigger", "wait", "acknowledge", "release")
BEATS_S, ASKS_S = 0.3, 0.12
GIVES_UP_S = 25.0
HEARD_S = 0.3
"""The loop has done what a trigger asks for by then."""

Port = ModbusPort | OpcUaPort
T = TypeVar("T")


class Cut(Exception):
    """A request has no answer."""


class Server:
    """The port of the station, over all of its lives. kind: of `PORTS`."""

    now: ClassVar["Server"]
    name = "simulated"
    has_ended = False

    def __init__(self, clock: "SimulatedClock", is_dead: Callable[[], bool], kind: str) -> None:
        self._clock, self._is_dead, self.kind = clock, is_dead, kind
        self._port: Port | None = None
        self._handshake: Handshake | None = None
        self.is_frozen = False
        self._late: list[Callable[[Port], object]] = []
        """Requests that came while the process got no time."""

    @property
    def has_result(self) -> bool:
        """Whether a result waits for its acknowledgement."""
        return self._handshake is not None and self._handshake.read().step == "done"

    @property
    def is_pass(self) -> bool:
        """Whether it is a pass."""
        return self._handshake is not None and self._handshake.read().is_pass

    def start(self, handshake: Handshake) -> None:
        self._handshake, self._port = handshake, PORTS[self.kind](handshake, self._clock)
        self._late.clear()

    def close(self) -> None:
        self._handshake = self._port = None

    def answer(self, request: Callable[[Port], T]) -> T:
        """Errors: Cut."""
        if self._port is None or self._is_dead():
            raise Cut
        if self.is_frozen:
            self._late.append(request)
            raise Cut
        late, self._late = self._late, []
        for one in late:
            one(self._port)
        return request(self._port)

    def forget(self, line: Line) -> None:
        """The server notices that a connection has ended."""
        line.is_gone = True
        if self._port is not None:
            self._port.forget(line)


class ServerPlugin:
    """The port of the run."""

    Options = NoOptions

    def open(self, options: NoOptions, clock: Clock) -> Server:
        return Server.now


server_plugin = ServerPlugin()


@dataclass(frozen=True)
class Shown:
    """The status word with the id, read in one request."""

    at_ns: int
    bits: Collection[str]
    trigger_id: int

    def has(self, name: str) -> bool:
        return name in self.bits

    @property
    def words(self) -> list[str]:
        return [word for word in WORDS if self.has(word)]


@dataclass
class Asked:
    """A trigger. Times are None where the PLC does not know."""

    sent_ns: int
    part: str | None
    """That it names, and the piece."""
    piece: str
    taken_ns: int | None = None
    busy_ns: int = 0
    """It was last read then that the trigger waits for its press."""
    acknowledged_ns: int | None = None
    """The answer to an acknowledgement came then."""
    words: list[tuple[str, int]] = field(default_factory=list)
    """Its results as they were read, each with the first time."""


class Plc:
    """One client with a program of its own.

    mood: `up`, `cut` (its cable), `mute` (its watchdog stands still) or `slow` (it acknowledges late, or never).
    """

    def __init__(
        self, clock: "SimulatedClock", server: Server, rng: random.Random, ip: str, first_id: int
    ) -> None:
        self._clock, self._server, self._rng, self.ip = clock, server, rng, ip
        self.mood, self.well_since_ns = "up", 0
        self.cut_at: str | None = None
        """The step at which its cable is pulled next."""
        self.on_cut: Callable[[], None] = lambda: None
        self.on_part: Callable[[str | None], None] = lambda part: None
        """Called with the part that a trigger has selected; None where nobody knows whether it has."""
        self.asked: dict[int, Asked] = {}
        self.shown: list[Shown] = []
        """What it has read, and no auditor has looked at."""
        self.writes_ns: list[int] = []
        """When a write was taken; `refused_ns`: when not."""
        self.refused_ns: list[int] = []
        self.acknowledges_ns: list[int] = []
        """When it acknowledged, taken or not: a trigger that is busy ends with it."""
        self.left_ns = 1 << 62
        self.cuts: set[str] = set()
        """The steps at which its cable was pulled."""
        self.on_piece: Callable[[int, str | None], None] | None = None
        """Called with what is known since when, where the station has a plan of places; None while nobody knows."""
        self._piece = ""
        self._line, self._step, self._next_id, self._id = Line(clock, ip), "ready", first_id, 0
        self._since_ns = self._beat_ns = 0
        self._is_high = self._has_cut = False
        self._pause_s = 0.0

    @property
    def step(self) -> str:
        return self._step

    @property
    def waits_for_part(self) -> bool:
        """It waits for the press of a part that it has named, and that is selected by now."""
        is_heard = self._clock.now_ns - self._since_ns > HEARD_S * S
        return self._step == "wait" and self.asked[self._id].part is not None and is_heard

    @property
    def waits_for_piece(self) -> bool:
        """It waits for the press of a piece that it has named, and that is begun by now."""
        is_heard = self._clock.now_ns - self._since_ns > HEARD_S * S
        return self._step == "wait" and self.asked[self._id].piece != "" and is_heard

    @property
    def has_just_asked(self) -> bool:
        """The station may not have done yet what its trigger asks for."""
        sent_ns = self.asked[self._id].sent_ns if self._id in self.asked else 0
        return 0 <= self._clock.now_ns - sent_ns < HEARD_S * S

    def act(self) -> float:
        """Take one turn; returns the seconds until the next one."""
        now_ns = self._clock.now_ns
        try:
            if self.mood != "mute" and now_ns - self._beat_ns > BEATS_S * S:
                self._beat_ns, self._is_high = now_ns, not self._is_high
                self._write(lambda port, line: port.beat(line, self._is_high))
            getattr(self, f"_{self._step}")()
        except Cut:
            self._reconnect()
        return ASKS_S

    def mend(self) -> None:
        """Its cable is plugged in, and its program is quick."""
        self.mood, self.well_since_ns, self._has_cut = "up", self._clock.now_ns, False

    def leave(self) -> None:
        """Its program ends."""
        self.left_ns = self._clock.now_ns
        self._server.forget(self._line)

    # The steps of the program

    def _ready(self) -> None:
        shown = self._look()
        if self._clock.now_ns < self._since_ns + self._pause_s * S:
            return
        if shown.has("done") or shown.has("busy"):  # of before, as after a restart of the PLC
            self._go("acknowledge")
        elif shown.has("ready"):
            self._go("ask")

    def _ask(self) -> None:
        self._id, self._next_id = self._next_id, self._next_id + 1
        is_new = self.on_piece is None or not self._piece or self._rng.random() < 0.4
        self._piece = f"piece {self._id}" if is_new else self._piece
        # Of a piece most programs name the place, right or wrong, that of a new one often wrong.
        parts = (None, *PARTS, *PARTS[is_new:]) if self.on_piece else (None, None, None, *PARTS)
        part = self._rng.choice(parts)
        piece = "" if self.on_piece and self._rng.random() < 0.1 else self._piece
        asked = self.asked[self._id] = Asked(1 << 62, part, piece)
        self._request(lambda port, line: port.load(line, self._id, piece, _name(asked.part)))
        self._go("trigger")

    def _trigger(self) -> None:
        number, asked = self._id, self.asked[self._id]
        asked.sent_ns = self._clock.now_ns
        if asked.part is not None:
            self.on_part(None)
        if self.on_piece is not None and asked.piece:
            self.on_piece(asked.sent_ns, None)
        if self._write(lambda port, line: port.trigger(line, number, asked.piece, _name(asked.part))):
            asked.taken_ns = self._clock.now_ns
            if asked.part is not None:
                self.on_part(asked.part)
            self._go("wait")
        else:
            self._go("release")

    def _wait(self) -> None:
        shown, asked = self._look(), self.asked[self._id]
        is_answered = shown.trigger_id == self._id and shown.has("done") and not shown.has("error")
        if self.on_piece is not None and asked.piece and asked.taken_ns and is_answered:
            self.on_piece(asked.taken_ns, asked.piece)
        if shown.trigger_id != self._id or self._clock.now_ns - self._since_ns > GIVES_UP_S * S:
            self._go("acknowledge")  # the station has begun anew, or does not end it
        elif shown.has("done") and self.mood != "slow":
            self._go("acknowledge")

    def _acknowledge(self) -> None:
        shown = self._look()
        self.acknowledges_ns.append(self._clock.now_ns)
        if self._write(lambda port, line: port.acknowledge(line)) and shown.trigger_id in self.asked:
            self.asked[shown.trigger_id].acknowledged_ns = self._clock.now_ns
        self._go("release")

    def _release(self) -> None:
        if self._write(lambda port, line: port.lower(line)):
            self._pause_s = self._rng.choice((0.0, 0.0, 0.7, 1.5))
            self._go("ready")

    def _go(self, step: str) -> None:
        self._step, self._since_ns = step, self._clock.now_ns

    def _reconnect(self) -> None:
        """A new connection; half of the programs go on, half begin again. The server may not know that the old one has
        ended."""
        if self._rng.random() < 0.5:
            self._server.forget(self._line)
        self._line = Line(self._clock, self.ip)
        if self._step in ("ask", "trigger") or self._rng.random() < 0.5:
            self._go("release")

    # Requests

    def _look(self) -> Shown:
        shown = Shown(self._clock.now_ns, *self._request(lambda port, line: port.read(line)))
        self.shown.append(shown)
        return shown

    def _write(self, request: Callable[[Port, Line], bool | None]) -> bool:
        """Return whether it was taken; None where there is nothing to write."""
        if (is_taken := self._request(request)) is None:
            return True
        (self.writes_ns if is_taken else self.refused_ns).append(self._clock.now_ns)
        return is_taken

    def _request(self, request: Callable[[Port, Line], T]) -> T:
        """Errors: Cut; the request may have arrived all the same."""
        if self.cut_at == self._step:
            self.cut_at = None
            self.cuts.add(self._step)
            self.on_cut()
        line = self._line

        def ask(port: Port) -> T:
            line.heard_ns = self._clock.now_ns
            return request(port, line)

        if self.mood == "cut":
            is_under_way, self._has_cut = not self._has_cut, True
            if is_under_way and self._rng.random() < 0.5:
                self._server.answer(ask)
            raise Cut
        return self._server.answer(ask)


def _name(part: str | None) -> str:
    return "" if part is None else f"{part}/pos1"
