"""The handshake with a PLC: one server, and the loop that tells its machine of presses.

No result goes through the outbox: a PLC never sees one of an earlier start. No press of a master piece or of a study
answers a trigger.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Self, final

from edge import registry
from edge.clock import SystemClock
from edge.config import Config, HandshakeTable
from edge.core.contact.events import Event, PressBegan, PressSettled, TriggerRepeated, TriggerWithoutContact
from edge.core.contact.press_detector import Look
from edge.core.digital_io import StationView
from edge.core.errors import GelgateError, StoreError
from edge.core.gel_life import GelState
from edge.core.handshake import Code, HandshakeMachine, HandshakeServer, Trigger
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Reason, Rejection
from edge.core.part_position import PartPosition
from edge.core.press import Press, PressLabel
from edge.core.sentence import Sentence
from edge.features.handshake.port import PLC, Port
from edge.model.inspector import Inspector
from edge.press_stage import Mounted, PressStage, StageParts
from edge.store.acts import select_part
from edge.store.gel_ledger import GelRecord

__all__ = ["HandshakeStage"]

log = logging.getLogger(__name__)


@final
class HandshakeStage(PressStage):
    """Shows a PLC what the stages before have decided."""

    is_awaited = True

    def __init__(self, parts: StageParts, table: HandshakeTable, server: HandshakeServer) -> None:
        self._parts, self._clock, self._server = parts, parts.clock, server
        self._is_command = parts.config.inspection.trigger == "command"
        watchdog_ns = None if table.watchdog_s is None else round(table.watchdog_s * 1e9)
        now_ns = self._clock.monotonic_ns()
        machine = HandshakeMachine(
            round(table.timeout_s * 1e9), watchdog_ns, now_ns, is_command=self._is_command
        )
        self.port = Port(machine, parts.selection, parts.store, parts.clock, self._triggered)
        self._gel_left_percent = 0
        self._has_contact = self._has_time = False
        self._is_touched = True  # until the gel is seen free
        self._began_ns: int | None = None
        self._piece_id: str | None = None
        # Its piece begins when what touches now is lifted.
        self._early: tuple[Trigger, PartPosition | None] | None = None
        self._answer = ("", 0)

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        """Take the port of the configured server, which does not serve yet. Errors: ConfigError."""
        table = parts.config.handshake
        if table is None:
            return None
        return cls(parts, table, table.opener(registry.handshake(table.plugin), parts.clock)())

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        if config.handshake is not None:
            yield f"handshake {config.handshake.plugin}", partial(_try_server, config.handshake)

    def start(self) -> None:
        self._server.start(self.port)

    def close(self) -> None:
        """The PLC sees a connection that ends, and no result."""
        self._server.close()

    def _triggered(self, trigger: Trigger, part: PartPosition | None) -> None:
        """Let the loop do what a trigger asks for. The server's thread calls it."""
        self._parts.post(partial(self._reach, trigger, part))
        if self._is_command:
            self._parts.trigger()

    def _reach(self, trigger: Trigger, part: PartPosition | None) -> None:
        """Begin the piece of several places that a trigger names, unless it is in progress; where something touches,
        once that is lifted. Then select its part, for the plan has selected the piece's first place. Where one of them
        fails the result is an error. Nothing for one that is not busy any more."""
        view = self.port.read()
        if (view.step, view.trigger_id) != ("busy", trigger.trigger_id):
            return
        is_new = trigger.piece not in ("", self._piece_id) and self._parts.config.piece is not None
        if is_new and (self._has_contact or self._is_touched) and not self._is_command:
            self._early = trigger, part
            return
        with self.port.machine() as (machine, _):
            machine.reach(trigger.trigger_id)
        if is_new:
            try:
                self._parts.do("begin_piece", {"piece_id": trigger.piece})
            except (GelgateError, ValueError) as error:
                self.port.refuse("begin_piece", str(error))
                self._miss(Code.PIECE)
                return
        if part is not None:
            self._select(part, trigger)

    def _select(self, part: PartPosition, trigger: Trigger) -> None:
        """Select the part that a trigger names, instead of one that waits. Where that fails the result is an error."""
        selection, before = self._parts.selection, self._parts.selection.part
        if part == before and not selection.is_waiting:
            return
        if part not in selection.find_all(str(part)):  # a reload has taken its bundle away
            self._miss(Code.UNKNOWN_PART)
            return
        why = select_part(self._clock.time_ns(), PLC, vars(trigger), before, part)
        try:
            selection.select(part, None if part == before else why, is_pressed=self._has_contact)
        except StoreError as error:
            log.error("the part '%s' that the PLC names is not selected: %s", part, error)
            self._miss(Code.OTHER_PART)

    def _miss(self, code: Code) -> None:
        with self.port.machine() as (machine, now_ns):
            machine.miss(code, now_ns)

    def mount(self, gel: GelRecord) -> None:
        self._gel_left_percent = _left(gel)

    def take(self, frame: CameraFrame) -> None:
        self._has_time = not frame.is_on_demand

    def see(self, event: Event) -> None:
        match event:
            case PressBegan():
                self._began_ns = event.timestamp_ns if self._has_time else None
            case TriggerWithoutContact() | TriggerRepeated() if self._is_command:
                self._miss(Code.NOTHING_PRESSED)
            case _:
                pass

    def look(self, look: Look) -> None:
        if look.phase == "unseen":  # what touched before may touch still, and nothing else is known to
            return
        self._is_touched = look.phase != "free"
        with self.port.machine() as (machine, _):
            machine.look(self._is_touched)

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        if label is None:
            with self.port.machine() as (machine, now_ns):
                machine.begin(now_ns, self._began_ns)
        return label

    def admit(self, press: Press) -> Press:
        """Return it with the piece that its trigger names, and rejected where it answers a trigger for another part: it
        would count for a place of the piece at which the part does not lie."""
        if press.label is not None:
            return press
        selected = self._parts.selection.part
        with self.port.machine() as (machine, now_ns):
            trigger_id, part, piece = machine.find_asked(now_ns)
        press = replace(press, trigger_id=trigger_id, asked_piece=piece)
        if part in (None, str(selected)):
            return press
        reason = Sentence(f"the PLC asks for {part}, and {selected} is selected; see `gelgate station acts`")
        return press.reject(Rejection(Reason.OTHER_PART, reason))

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        if press.label is None:
            manifest, verdict = inspector.bundle.manifest, press.verdict
            part = str(PartPosition(manifest.part, manifest.position))
            piece = press.piece.piece_id if press.piece else None
            score, limit = (verdict.score, verdict.threshold or 0.0) if verdict else (None, 0.0)
            ratio = score / limit if score is not None and limit > 0 else None
            with self.port.machine() as (machine, now_ns):
                word = press.shown or "place"
                if machine.judge(press.press_id, word, now_ns, part=part, piece=piece, score_ratio=ratio):
                    self._answer = (press.press_id, machine.read(now_ns).trigger_id)
        return press

    def fields(self, press: Press) -> Mapping[str, Any]:
        press_id, trigger_id = self._answer
        return {"trigger_id": trigger_id} if press.press_id == press_id else {}

    def record(self, press: Press, gel: GelRecord) -> None:
        self._gel_left_percent = _left(gel)
        with self.port.machine() as (machine, now_ns):
            machine.record(press.press_id, now_ns)

    def turn(self, mounted: Mounted | None) -> None:
        """Take a trigger that waited for a lift, and record what was refused. Errors: StoreError."""
        self._has_contact = mounted is not None and mounted.has_contact
        if (early := self._early) is not None and not (self._has_contact or self._is_touched):
            self._early = None
            self._reach(*early)
        self.port.record()

    def show(self, view: StationView) -> None:
        self._piece_id = view.piece_id
        with self.port.machine() as (machine, now_ns):
            seen = machine.show(view, self._gel_left_percent, now_ns)
            is_silent, is_unread = machine.is_silent(now_ns), machine.is_unread(now_ns)
        alarm = None
        if self._server.has_ended:
            alarm = Sentence(
                f"{self._server.name} has ended by itself, so the PLC reaches nothing; see the log, and restart the "
                "gateway"
            )
        elif is_silent:
            alarm = Sentence("the PLC's watchdog stands still, so its triggers are refused")
        elif is_unread:
            alarm = Sentence(
                f"the PLC does not acknowledge the result of trigger {seen.trigger_id}, so the next is refused"
            )
        self._parts.alarms.say("plc", alarm)


def _left(gel: GelRecord) -> int:
    """Return the percent of its presses that a gel has left, 0 for one that must be replaced."""
    if gel.state is GelState.REPLACE:
        return 0
    return max(0, 100 * (gel.limit_presses - gel.presses) // gel.limit_presses)


def _try_server(table: HandshakeTable) -> str:
    """Take the port, and free it. Errors: ConfigError."""
    server: HandshakeServer = table.opener(registry.handshake(table.plugin), SystemClock())()
    name = server.name
    server.close()
    return name
