"""PLCs at the register map of a station (docs/plc.md), each with a line that may be cut, and the server that they ask.

The registers are those of the Modbus server; a request is a call in place of a packet.
"""

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from edge.core.handshake import Handshake
from edge.core.ports import Clock
from plugins.handshakes.modbus import _Registers
from simulation.bundles import PARTS
from simulation.options import NoOptions

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
TRIGGER, ACKNOWLEDGE, WATCHDOG = 0, 1, 2
WORDS = ("pass", "fail", "unsure", "rejected", "error")
STEPS = ("ready", "ask", "trigger", "wait", "acknowledge", "release")
WRITES_ALONE_S = 3.0
BEATS_S, ASKS_S = 0.3, 0.12
GIVES_UP_S = 25.0


class Cut(Exception):
    """A request has no answer."""


class Line:
    """A connection of one client, as the server sees it."""

    def __init__(self) -> None:
        self.is_gone = False


class Server:
    """The port of the station, over all of its lives. on_start: the registers of a new life, or None."""

    now: ClassVar["Server"]
    name = "simulated"

    def __init__(self, clock: "SimulatedClock", is_dead: Callable[[], bool]) -> None:
        self._clock, self._is_dead = clock, is_dead
        self.registers: _Registers | None = None
        self._handshake: Handshake | None = None
        self.is_frozen = False
        self._late: list[tuple[bytes, Line, str]] = []
        """Requests that came while the process got no time."""

    @property
    def has_result(self) -> bool:
        """Whether a result waits for its acknowledgement."""
        return self._handshake is not None and self._handshake.read().step == "done"

    def start(self, handshake: Handshake) -> None:
        self._handshake, self.registers = handshake, _Registers(handshake, self._clock)
        self._late.clear()

    def close(self) -> None:
        self._handshake = self.registers = None

    def answer(self, request: bytes, line: Line, ip: str) -> bytes:
        """Errors: Cut."""
        if self.registers is None or self._is_dead():
            raise Cut
        if self.is_frozen:
            self._late.append((request, line, ip))
            raise Cut
        late, self._late = self._late, []
        for one in late:
            self.registers.answer(*one)  # type: ignore[arg-type]  # a line in place of a connection
        return self.registers.answer(request, line, ip)  # type: ignore[arg-type]

    def forget(self, line: Line) -> None:
        """The server notices that a connection has ended."""
        line.is_gone = True
        if self.registers is not None:
            self.registers.forget(line)  # type: ignore[arg-type]


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
    bits: int
    trigger_id: int

    def has(self, name: str) -> bool:
        names = ("ready", "busy", "done", *WORDS, "not passed")
        return bool(self.bits >> names.index(name) & 1)

    @property
    def words(self) -> list[str]:
        return [word for word in WORDS if self.has(word)]


@dataclass
class Asked:
    """A trigger. Times are None where the PLC does not know."""

    sent_ns: int
    part: str | None
    """That it names."""
    taken_ns: int | None = None
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
        self.mood = "up"
        self.cut_at: str | None = None
        """The step at which its cable is pulled next."""
        self.on_cut: Callable[[], None] = lambda: None
        self.on_part: Callable[[str | None], None] = lambda part: None
        """Called with the part that a trigger has selected; None where nobody knows whether it has."""
        self.asked: dict[int, Asked] = {}
        self.found: list[str] = []
        """What must not be."""
        self.shown: list[Shown] = []
        """What it has read, and no auditor has looked at."""
        self.writes_ns: list[int] = []
        """When a write was taken; `refused_ns`: when not."""
        self.refused_ns: list[int] = []
        self.left_ns = 1 << 62
        self.cuts: set[str] = set()
        """The steps at which its cable was pulled."""
        self._line, self._step, self._next_id, self._id = Line(), "ready", first_id, 0
        self._since_ns = self._beat_ns = 0
        self._is_high = self._has_cut = False
        self._pause_s = 0.0

    @property
    def step(self) -> str:
        return self._step

    def act(self) -> float:
        """Take one turn; returns the seconds until the next one."""
        now_ns = self._clock.now_ns
        try:
            if self.mood != "mute" and now_ns - self._beat_ns > BEATS_S * S:
                self._beat_ns, self._is_high = now_ns, not self._is_high
                self._write_coils(WATCHDOG, [self._is_high])
            getattr(self, f"_{self._step}")()
        except Cut:
            self._reconnect()
        return ASKS_S

    def mend(self) -> None:
        """Its cable is plugged in, and its program is quick."""
        self.mood, self._has_cut = "up", False

    def leave(self) -> None:
        """Its program ends."""
        self.left_ns = self._clock.now_ns
        self._server.forget(self._line)

    # The steps of the program

    def _ready(self) -> None:
        shown = self._look()
        if shown is None or self._clock.now_ns < self._since_ns + self._pause_s * S:
            return
        if shown.has("done") or shown.has("busy"):  # of before, as after a restart of the PLC
            self._go("acknowledge")
        elif shown.has("ready"):
            self._go("ask")

    def _ask(self) -> None:
        self._id, self._next_id = self._next_id, self._next_id + 1
        part = self._rng.choice((None, None, None, *PARTS))
        text = b"" if part is None else f"{part}/pos1".encode()
        words = struct.pack(">I32s32s", self._id, f"piece {self._id}".encode(), text)
        self.asked[self._id] = Asked(1 << 62, part)
        self._request(struct.pack(">BHHB", 16, 0, len(words) // 2, len(words)) + words)
        self._go("trigger")

    def _trigger(self) -> None:
        asked = self.asked[self._id]
        asked.sent_ns = self._clock.now_ns
        if asked.part is not None:
            self.on_part(None)
        if self._write_coils(TRIGGER, [True]):
            asked.taken_ns = self._clock.now_ns
            if asked.part is not None:
                self.on_part(asked.part)
            self._go("wait")
        else:
            self._go("release")

    def _wait(self) -> None:
        shown = self._look()
        if shown is None:
            return
        if shown.trigger_id != self._id or self._clock.now_ns - self._since_ns > GIVES_UP_S * S:
            self._go("acknowledge")  # the station has begun anew, or does not end it
        elif shown.has("done") and self.mood != "slow":
            self._go("acknowledge")

    def _acknowledge(self) -> None:
        shown = self._look()
        if self._write_coils(ACKNOWLEDGE, [True]) and shown is not None and shown.trigger_id in self.asked:
            self.asked[shown.trigger_id].acknowledged_ns = self._clock.now_ns
        self._go("release")

    def _release(self) -> None:
        if self._write_coils(TRIGGER, [False, False]):
            self._pause_s = self._rng.choice((0.0, 0.0, 0.7, 1.5))
            self._go("ready")

    def _go(self, step: str) -> None:
        self._step, self._since_ns = step, self._clock.now_ns

    def _reconnect(self) -> None:
        """A new connection; half of the programs go on, half begin again. The server may not know that the old one has
        ended."""
        if self._rng.random() < 0.5:
            self._server.forget(self._line)
        self._line = Line()
        if self._step in ("ask", "trigger") or self._rng.random() < 0.5:
            self._go("release")

    # Requests

    def _look(self) -> Shown | None:
        answer = self._request(struct.pack(">BHH", 4, 0, 3))
        if answer[0] != 4:
            self.found.append(f"the PLC reads, and is answered exception {answer[1:].hex()}")
            return None
        bits, high, low = struct.unpack(">HHH", answer[2:])
        shown = Shown(self._clock.now_ns, bits, high << 16 | low)
        self.shown.append(shown)
        return shown

    def _write_coils(self, start: int, bits: list[bool]) -> bool:
        packed = sum(bit << n for n, bit in enumerate(bits))
        answer = self._request(struct.pack(">BHHBB", 15, start, len(bits), 1, packed))
        is_taken = answer[0] == 15
        (self.writes_ns if is_taken else self.refused_ns).append(self._clock.now_ns)
        return is_taken

    def _request(self, request: bytes) -> bytes:
        """Errors: Cut; the request may have arrived all the same."""
        if self.cut_at == self._step:
            self.cut_at = None
            self.cuts.add(self._step)
            self.on_cut()
        if self.mood == "cut":
            is_under_way, self._has_cut = not self._has_cut, True
            if is_under_way and self._rng.random() < 0.5:
                self._server.answer(request, self._line, self.ip)
            raise Cut
        return self._server.answer(request, self._line, self.ip)
