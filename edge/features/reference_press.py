"""Reference presses of a running station: who asked for one, when the next is due, and whether parts may be judged."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Self

from pydantic import Field

from edge.config.feature_tables import MasterPieceTable
from edge.core.contact.events import Event, PressSettled, ReferenceReady
from edge.core.imaging.quality import Reason, Rejection
from edge.core.part_position import PartPosition
from edge.core.ports import Message
from edge.core.press import Press, PressLabel, ReferenceLabel
from edge.core.reference_press.charts import ReferencePress, judge, why_due
from edge.core.reference_press.outcome import Imprint, Outcome
from edge.core.sentence import Sentence
from edge.core.suggest import suggestion
from edge.core.verdict import Verdict
from edge.messaging.command_payloads import CommandArguments, PlainText
from edge.messaging.reference_message import describe_reference_press
from edge.messaging.result_payload import ResultPayload
from edge.model.inspector import Inspector
from edge.press_stage import Command, Data, Mounted, OwnTable, PressStage, StageParts
from edge.store import reference_presses
from edge.store.acts import Act
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord
from edge.store.reference_presses import PieceKey, ReferenceRequest
from edge.store.reference_presses import ReferenceTable as PieceTable

__all__ = ["ReferenceGuard"]

log = logging.getLogger(__name__)

# Requests of the command line are looked for, and what is due is found, this often.
LOOK_S: Final = 0.5
# A request of the command line that is older was made while no gateway ran.
OLDEST_REQUEST_S: Final = 60.0


class ReferencePressArguments(CommandArguments):
    """Of `cmd/reference_press`. piece: may be left out where there is one. restart: its charts begin again. cancel: no
    reference press is waited for any more."""

    piece: PlainText | None = Field(default=None, min_length=1, max_length=64)
    restart: bool = False
    cancel: bool = False


@dataclass(frozen=True)
class _Armed:
    """The next press is this one, until the monotonic time."""

    label: ReferenceLabel
    until_ns: int
    is_void: bool = False
    """Part, bundle, gel or sensor has changed since it was asked for."""


class ReferenceGuard(PressStage):
    """Knows which press is a master piece's, measures it, and refuses parts while one is due or out of limits."""

    def __init__(self, parts: StageParts) -> None:
        self._table, self._clock = parts.config.reference, parts.clock
        self._store, self._alarms = parts.store, parts.alarms
        self._mounted: Mounted | None = None
        self._is_gel_known = False
        self._armed: _Armed | None = None
        self._void: Sentence | None = None  # why the press that has begun is rejected
        self._presses: dict[str, list[ReferencePress]] = {}
        self._faults: tuple[str, ...] = ()
        self._next_look_ns = 0

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts)

    def request(self, piece: str | None, *, is_start: bool = False) -> ReferenceLabel:
        """The next press is that of this master piece. piece: may be None where there is one. Errors: ValueError."""
        if self._mounted is None:
            raise ValueError(
                "no frame has arrived from a sensor yet, so its gel is not known; try again later"
            )
        if self._mounted.has_contact:
            raise ValueError("something presses the gel; lift it, then ask for the reference press")
        if not self._is_gel_known:  # the next part would be taken for a press that no one notices
            raise ValueError(
                "the free gel is not known yet, so no press is noticed; wait until the station is ready, then ask for "
                "the reference press"
            )
        chosen = self._choose_piece(self._mounted, piece)
        label = ReferenceLabel(chosen.name, chosen.verdict, self._table.learn, is_start)
        self._armed = _Armed(label, self._clock.monotonic_ns() + round(self._table.within_s * 1e9))
        self._say()
        return label

    def cancel(self) -> None:
        """The next press is a part's. Errors: ValueError where no reference press is waited for."""
        if self._armed is None:
            raise ValueError("no reference press is waited for")
        self._armed = None
        self._say()

    def _answer(self, arguments: ReferencePressArguments) -> Data:
        if arguments.cancel:
            self.cancel()
            return {"is_waiting": False}
        label = self.request(arguments.piece, is_start=arguments.restart)
        return {"piece": label.piece, "is_waiting": True, "within_s": self._table.within_s}

    commands = (
        Command(
            "reference_press",
            ReferencePressArguments,
            _answer,
            "the next press is that of a master piece; its outcome is on the topic `reference`. `restart`: its charts "
            "begin again; `cancel`: the next press is a part's",
            "the charts of the master piece",
        ),
    )

    def turn(self, mounted: Mounted | None) -> None:
        now_ns = self._clock.monotonic_ns()
        before, self._mounted = self._mounted, mounted
        has_changed = mounted is not None and (
            before is None or replace(mounted, has_contact=before.has_contact) != before
        )
        if has_changed:
            if self._armed is not None:
                self._armed = replace(self._armed, is_void=True)
            self._read()
        if not has_changed and now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + round(LOOK_S * 1e9)
        self._take_request()
        if self._armed is not None and now_ns > self._armed.until_ns:
            log.warning("the reference press of %s did not come in time", self._armed.label.piece)
            self._armed = None
        self._look_for_faults()

    def see(self, event: Event) -> None:
        self._is_gel_known |= isinstance(event, ReferenceReady)

    def relearn(self) -> None:
        self._is_gel_known = False

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        armed, self._armed = self._armed, None
        self._void = None if armed is None else _say_void(armed)
        return label if armed is None or armed.is_void else armed.label

    def admit(self, press: Press) -> Press:
        is_refusing = self._table.enforce == "refuse" and bool(self._faults)
        why = self._void or (Sentence("; ".join(self._faults)) if is_refusing else None)
        if press.label is not None or why is None:
            return press
        return press.reject(Rejection(Reason.REFERENCE, why))

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        if settled is None or not isinstance(press.label, ReferenceLabel):
            return press
        if press.is_at_rest is False:  # less deep than the others, perhaps: no measure of gel and fixture
            why = Sentence("the master piece was lifted before it rested; press it longer")
            return replace(press, verdict=Verdict.rejected(Rejection(Reason.NOT_SETTLED, why)))
        turn_rad = None if press.registered is None else press.registered.turn_rad
        return replace(press, imprint=Imprint.of(settled, inspector.bundle.profile, turn_rad))

    def table(self, press: Press, row: PressRecord) -> OwnTable | None:
        if not isinstance(press.label, ReferenceLabel):
            return None
        return _PublishedTable(press.label, press, row)

    def record(self, press: Press, gel: GelRecord) -> None:
        if press.label is not None:
            self._read()
            self._look_for_faults()

    def _read(self) -> None:
        """The earlier presses of what is mounted. Errors: StoreError."""
        if (mounted := self._mounted) is None:
            return
        self._presses = {
            piece.name: self._store.read(
                "reading the reference presses",
                partial(reference_presses.of_piece, key=PieceKey(mounted.serial, *mounted.part, piece.name)),
            )
            for piece in self._pieces(mounted.part)
        }

    def _pieces(self, part: PartPosition) -> list[MasterPieceTable]:
        """Return the master pieces of a part and position."""
        return [
            piece
            for piece in self._table.pieces
            if piece.part in (None, part.part) and piece.position in (None, part.position)
        ]

    def _choose_piece(self, mounted: Mounted, name: str | None) -> MasterPieceTable:
        """Return the master piece of this name. Errors: ValueError, which names those known."""
        part = mounted.part
        known = {piece.name: piece for piece in self._pieces(part)}
        if not known:
            raise ValueError(f"no master piece of {part} is configured; name it under [[reference.pieces]]")
        if name is None and len(known) == 1:
            return next(iter(known.values()))
        if name is None:
            raise ValueError(f"{part} has several master pieces ({', '.join(known)}); name one of them")
        if name not in known:
            raise ValueError(f"no master piece of {part} is named '{name:.64}'; {suggestion(name, known)}")
        return known[name]

    def _take_request(self) -> None:
        """Take a request of the command line, and write its row in the table of acts; it waits while something presses
        the gel, or the free gel is not known. Errors: StoreError."""
        if self._mounted is not None and (self._mounted.has_contact or not self._is_gel_known):
            return
        taken = reference_presses.take(self._store)
        if taken is None:
            return
        act = Act(
            self._clock.time_ns(),
            taken.who,
            "reference_press",
            taken.request,
            {"piece": taken.piece, "restart": taken.is_start},
            outcome="done",
        )
        why = self._why_not(taken)
        if why is not None:
            log.warning("a reference press was asked for and refused: %s", why)
            act = replace(act, outcome="refused", sentence=why)
        self._store.begin_act(act)

    def _why_not(self, taken: ReferenceRequest) -> str | None:
        """Do it, or say why not."""
        age_s = (self._clock.time_ns() - taken.time_ns) / 1e9
        if abs(age_s) > OLDEST_REQUEST_S:
            return f"it was asked for {age_s:.0f} s ago, while no gateway ran; ask again"
        try:
            self.request(taken.piece, is_start=taken.is_start)
        except ValueError as error:
            return str(error)
        return None

    def _look_for_faults(self) -> None:
        self._faults = tuple(self._find_faults())
        self._say()

    def _find_faults(self) -> Iterator[str]:
        """Say what is due, or out of limits."""
        mounted = self._mounted
        if mounted is None or self._table.enforce == "off":
            return
        for name, presses in self._presses.items():
            scored = [press for press in presses if press.is_scored]
            last_ns = _newest_with(scored, mounted)
            why = why_due(last_ns, self._clock.time_ns(), self._table.every_h, self._table.shifts)
            if why is not None:
                yield Sentence(
                    f"a reference press of {name} is due: {why}; ask for it (`gelgate station reference press`), then "
                    "press it"
                )
            elif (judgement := judge(scored, self._table.learn)).outcome is Outcome.OUT_OF_LIMITS:
                sentences = "; ".join(judgement.sentences)
                yield Sentence(
                    f"the reference press of {name} is out of limits: {sentences}; then press it again"
                )

    def _warnings(self) -> Iterator[str]:
        """Run rules: they are said, and refuse nothing."""
        if self._table.enforce == "off":
            return
        for name, presses in self._presses.items():
            if not presses:
                continue
            judgement = judge(presses, self._table.learn)
            if judgement.outcome is Outcome.WARNING:
                sentences = "; ".join(judgement.sentences)
                yield Sentence(f"the reference press of {name} is in its limits, with a warning: {sentences}")

    def _say(self) -> None:
        """The alarm `reference`; where parts are refused it halts the station."""
        is_refusing = self._table.enforce == "refuse" and bool(self._faults)
        sentences = [*self._faults, *self._warnings()]
        if self._armed is not None:
            piece, within_s = self._armed.label.piece, self._table.within_s
            wait = Sentence(
                f"the next press is the reference press of {piece}: press it within {within_s:g} s"
            )
            sentences.insert(0, _say_void(self._armed) or wait)
        text = Sentence("; ".join(sentences))
        if self._alarms.set_fault("reference", text if is_refusing else None):
            log.warning("%s", text)
        if not is_refusing:
            self._alarms.say("reference", text or None, "warning")


def _say_void(armed: _Armed) -> Sentence | None:
    piece = armed.label.piece
    text = Sentence(
        f"part, bundle, gel or sensor changed before the reference press of {piece} came: the next press is rejected; "
        "ask for it again"
    )
    return text if armed.is_void else None


class _PublishedTable(PieceTable):
    """The table of a master piece's presses; its newest one is published with its charts and picture."""

    has_picture = True

    def __init__(self, label: ReferenceLabel, press: Press, row: PressRecord) -> None:
        self._label = label
        key = PieceKey(row.serial, row.part, row.position or "", label.piece)
        reference_press = ReferencePress(
            row.press_id,
            row.time_ns,
            "",  # the gel is known once the press is counted
            press.bundle_id,
            label.expected,
            row.verdict,
            row.score,
            row.threshold,
            press.imprint or Imprint(),
            press.reason or press.error,
            label.is_start,
        )
        super().__init__(key, reference_press)

    def publish(self, result: ResultPayload, sequence: int) -> tuple[Sequence[Message], Sequence[str]]:
        judgement = judge(self.presses, self._label.learn)
        label = self._label
        payload = describe_reference_press(result, sequence, label.piece, label.expected, judgement)
        return [payload.message()], judgement.sentences


def _newest_with(scored: list[ReferencePress], mounted: Mounted) -> int | None:
    """When the newest of them was made, if it was made with this gel and bundle."""
    newest = scored[-1] if scored else None
    if newest is None or (newest.gel_id, newest.bundle_id) != (mounted.gel_id, mounted.bundle_id):
        return None
    return newest.time_ns
