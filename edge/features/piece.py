"""A piece that is pressed at several places: begun by an id or by its first press, one verdict when all places came.

What is known of a piece is in the database: a press, what it means for its piece, and the message of a piece that ends
are one transaction. So a station that is killed goes on with the piece that was in progress. The rule is in
`edge.core.piece`.
"""

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final, Self

from pydantic import Field

from edge.config import Config
from edge.config.feature_tables import PieceTable
from edge.core.contact.events import Event, PressBegan, PressSettled
from edge.core.errors import ConfigError, StoreError
from edge.core.imaging.quality import Reason, Rejection
from edge.core.part_position import PartPosition
from edge.core.piece import End, Piece, PieceVerdict, PlacePress, check_places
from edge.core.ports import Message
from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.messaging.command_payloads import CommandArguments, PlainText
from edge.messaging.piece_payloads import PiecePayload, PieceResultPayload
from edge.model.inspector import Inspector
from edge.press_stage import Command, Data, Mounted, PressStage, StageParts
from edge.store import pieces
from edge.store.acts import select_part
from edge.store.gel_ledger import GelRecord
from edge.store.ulid import new_ulid

__all__ = ["BEGIN", "Pieces"]

BEGIN: Final = "begin_piece"


class BeginPieceArguments(CommandArguments):
    """Of `cmd/begin_piece`. piece_id: that of the piece, once ever; by default the station makes one."""

    piece_id: PlainText | None = Field(default=None, min_length=1, max_length=64)


class Pieces(PressStage):
    """Says which press is of which piece and place, ends pieces, and selects the bundle of the next place.

    A press counts once it is recorded; while one waits for that, no other is taken.
    """

    def __init__(self, table: PieceTable, parts: StageParts) -> None:
        self._plan, self._order, self._within_s = table.plan, table.order, table.within_s
        self._store, self._clock, self._selection = parts.store, parts.clock, parts.selection
        self._alarms, self._announce = parts.alarms, parts.announce
        self._piece: Piece | None = None
        self._last: tuple[str, PieceVerdict] | None = None
        self._lock: Sentence | None = None
        """Why no press begins a piece: one that was left unfinished may still lie there."""
        self._due_ns = 0
        self._waiting_id: str | None = None
        """The press of a piece that is judged and not recorded."""
        self._is_stale = True
        """What is known here may be older than the database."""
        self._wanted: PartPosition | None = None
        """The place whose bundle is to be selected."""
        self._is_command = parts.config.inspection.trigger == "command"
        self._has_contact = False
        self._is_undecided = False  # it is pressed, and the press has no verdict
        self._said: object = None

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        """Go on with the piece that was in progress. Errors: ConfigError for a place without a bundle, StoreError."""
        if parts.config.piece is None:
            parts.announce(Message(PiecePayload.topic, b"", retain=True))  # of an earlier configuration
            return None
        check_places(parts.config.piece.plan, parts.selection.find_all)
        stage = cls(parts.config.piece, parts)
        stage._refresh()
        if stage._order == "free" and parts.store.read("reading the selection", pieces.is_selected_since):
            stage._wanted = None  # by the plan, or by somebody who has selected another place since
        return stage

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        if config.piece is not None:
            yield "piece", partial(_describe, config)

    def see(self, event: Event) -> None:
        if isinstance(event, PressBegan):
            self._is_undecided = True

    def admit(self, press: Press) -> Press:
        """Return it with its piece and place, and rejected where the piece is not to be pressed there now."""
        self._is_undecided = False
        if press.label is not None:
            return press
        piece, begins, refusal = self._piece, False, None
        if not press.is_decided:
            piece, begins, refusal = self._piece_of(press)
        place = self._selection.part
        if refusal is None and piece is not None and place not in piece.expected:
            refusal = _refuse_place(piece, place)
            if begins and piece.piece_id not in _codes(press):
                piece = None  # a press at another place begins no piece that has no id
        if piece is not None:
            others = [one for one in piece.missing if one != place]
            where = place if refusal is None and place in piece.expected else None
            press = replace(
                press, piece=PlacePress(piece.piece_id, where, begins, piece.has_failed, not others)
            )
        return press if refusal is None else press.reject(Rejection(Reason.NO_PLACE, refusal))

    def _piece_of(self, press: Press) -> tuple[Piece | None, bool, Sentence | None]:
        """Find the piece of a press: (piece, whether it begins with it, why the press is refused)."""
        if self._waiting_id is not None or self._is_stale:
            early = Sentence("the press before is not recorded yet; press again when the station is ready")
            return None, False, early
        codes, piece = _codes(press), self._piece
        if len(codes) > 1:
            several = Sentence(f"codes of several pieces are seen: {', '.join(codes)}; leave one in view")
            return piece, False, several
        if not codes and piece is None and self._lock is not None:
            return None, False, self._lock
        if piece is not None and codes in ((), (piece.piece_id,)):
            return piece, False, None
        piece_id = codes[0] if codes else new_ulid(press.time_ns)
        try:
            known = self._find_known(piece_id)
        except StoreError as error:
            known = Sentence(str(error))
        new = Piece(piece_id, press.time_ns, self._plan, self._order)
        return (new, True, None) if known is None else (piece, False, known)

    def _find_known(self, piece_id: str) -> Sentence | None:
        """Say why no piece may begin with this id; None for a new one. Errors: StoreError."""
        row = self._store.read("looking for a piece", partial(pieces.read_verdict, piece_id=piece_id))
        if row is None:
            return None
        over = Sentence(f"the piece {piece_id} is over ({row[0]})")
        state = Sentence(f"the piece {piece_id} is in progress") if row[0] is None else over
        return Sentence(f"{state}; an id is used once: begin a piece with an id of its own")

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """A touch that is not judged begins no piece that has no id."""
        piece = press.piece
        if piece is None or not piece.begins or piece.piece_id in _codes(press):
            return press
        return replace(press, piece=None) if press.word in ("rejected", "error") else press

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """From here on it waits to be recorded."""
        if press.piece is not None:
            self._waiting_id = press.press_id
        return press

    def fields(self, press: Press) -> Mapping[str, Any]:
        if press.piece is None:
            return {}
        place = press.piece.place
        return {"piece_id": press.piece.piece_id, "place": None if place is None else str(place)}

    def write(self, connection: sqlite3.Connection, press: Press) -> None:
        """Begin its piece where it is the first press of it, and end the piece where it is the last."""
        if press.piece is None:
            return
        last = pieces.read_last(connection)
        if press.piece.begins:
            if last is not None and last.ended_by is None:
                self._end(connection, last.piece, "next piece", press.time_ns)
            pieces.begin(connection, Piece(press.piece.piece_id, press.time_ns, self._plan, self._order))
            last = pieces.read_last(connection)
        if last is not None and last.ended_by is None and not last.piece.missing:
            self._end(connection, last.piece, "complete", press.time_ns)

    def record(self, press: Press, gel: GelRecord) -> None:
        self._settle()
        if press.label is None:
            self._choose()
            place = press.piece.place if press.piece else None
            if self._order == "free" and place is not None and place != self._selection.selected:
                self._wanted = None  # somebody has selected another place since it was pressed
            self._select()

    def turn(self, mounted: Mounted | None) -> None:
        """End a piece whose time is over, unless something is pressed or recorded just now. Errors: StoreError."""
        if mounted is None:
            return
        self._has_contact = mounted.has_contact
        self._settle()
        is_resting = not mounted.has_contact and self._waiting_id is None
        if self._piece is not None and is_resting and self._clock.monotonic_ns() >= self._due_ns:
            end = partial(self._end, piece=self._piece, why="time", time_ns=self._clock.time_ns())
            self._change("ending a piece", end)
        self._select()

    def begin_piece(self, piece_id: str | None) -> Piece:
        """Begin a piece; one in progress is over. Errors: ValueError, and then nothing has changed; StoreError."""
        if self._waiting_id is not None or self._is_stale:
            raise ValueError(
                "a press waits to be recorded; see the alarm `store`, and begin the piece after it"
            )
        if self._has_contact and not (self._is_command and self._is_undecided):
            raise ValueError("something presses the gel; lift the part, then begin the piece")
        time_ns, before = self._clock.time_ns(), self._piece
        piece_id = piece_id or new_ulid(time_ns)
        if (known := self._find_known(piece_id)) is not None:
            raise ValueError(known)
        piece = Piece(piece_id, time_ns, self._plan, self._order)

        def change(connection: sqlite3.Connection) -> None:
            if before is not None:
                self._end(connection, before, "next piece", time_ns)
            pieces.begin(connection, piece)

        self._change("beginning a piece", change)
        self._select()
        return piece

    def _change(self, doing: str, change: Callable[[sqlite3.Connection], None]) -> None:
        self._is_stale = True  # a commit that reports an error may have been made
        self._store.write(doing, change)
        self._refresh()

    @staticmethod
    def _end(connection: sqlite3.Connection, piece: Piece, why: End, time_ns: int) -> None:
        message = PieceResultPayload.of(piece, why, time_ns).message()
        pieces.end(connection, piece, why, time_ns, message)

    def _settle(self) -> None:
        """Count the press that waited once the database has it: also where the stage before could not take it."""
        if self._waiting_id is not None:
            is_there = partial(pieces.is_recorded, press_id=self._waiting_id)
            if self._store.read("looking for a press of a piece", is_there):
                self._waiting_id, self._is_stale = None, True
        if self._is_stale:
            self._refresh()

    def _refresh(self) -> None:
        """Read the piece in progress, and say what has changed. Errors: StoreError."""
        self._is_stale = True
        last = self._store.read("reading the piece in progress", pieces.read_last)
        self._is_stale = False
        before = self._piece
        self._piece = last.piece if last is not None and last.ended_by is None else None
        self._last = self._lock = None
        if last is not None and last.ended_by is not None and last.verdict is not None:
            self._last = last.piece.piece_id, last.verdict
            if last.ended_by == "time":
                self._lock = Sentence(
                    f"the piece {last.piece.piece_id} was not complete within {self._within_s:g} s, it lacks "
                    f"{_list(last.piece.missing)}; take it away, then begin the next piece "
                    f"with `{BEGIN}` or its code"
                )
        if self._piece is not None and (before is None or before.piece_id != self._piece.piece_id):
            passed_s = (self._clock.time_ns() - self._piece.began_ns) / 1e9
            left_s = self._within_s - min(max(0.0, passed_s), self._within_s)
            self._due_ns = self._clock.monotonic_ns() + round(left_s * 1e9)
        self._say()

    def _say(self) -> None:
        state = self._piece, self._last, self._lock
        if state == self._said:
            return
        self._said = state
        self._choose()
        piece = self._piece or self._next()
        payload = PiecePayload.of(
            piece, self._clock.time_ns(), is_begun=self._piece is not None, last=self._last
        )
        self._announce(payload.message())
        self._alarms.show_piece(None if self._piece is None else piece.piece_id)
        self._alarms.say("piece", self._lock, "warning")

    def _next(self) -> Piece:
        """What the next piece will be."""
        return Piece("", 0, self._plan, self._order)

    def _choose(self) -> None:
        """Choose the place whose bundle is selected: the next one in a fixed order, else the last one that is left."""
        piece = self._piece or self._next()
        is_certain = piece.order == "fixed" or len(piece.missing) == 1
        self._wanted = piece.expected[0] if is_certain else None

    def _select(self) -> None:
        """Select the bundle of the wanted place, once. Errors: StoreError; then the next turn tries again."""
        wanted, before = self._wanted, self._selection.part
        if wanted is None or wanted == before:
            self._wanted = None
            return
        if wanted not in self._selection.find_all(str(wanted)):
            lost = Sentence(
                f"the place {wanted} of the piece has no bundle any more; put it back, and reload"
            )
            self._alarms.say("piece", lost, "warning")
            return
        why = select_part(self._clock.time_ns(), "the plan of the piece", {}, before, wanted)
        self._selection.select(wanted, why, is_pressed=self._has_contact)
        self._wanted = None
        self._alarms.say("piece", self._lock, "warning")

    def _begin(self, arguments: BeginPieceArguments) -> Data:
        piece = self.begin_piece(arguments.piece_id)
        return {"piece_id": piece.piece_id, "expected": [str(place) for place in piece.expected]}

    commands = (
        Command(
            BEGIN,
            BeginPieceArguments,
            _begin,
            "begin a piece of several places (`[piece]`); one in progress is over, `incomplete` or `fail`. "
            "Refused while something presses, and for an id that was used before. `expected`: what may be pressed next",
            "the piece that presses belong to",
        ),
    )


def _codes(press: Press) -> tuple[str, ...]:
    """The ids of pieces that the overview camera has read."""
    return () if press.overview is None else press.overview.piece_ids


def _list(places: tuple[PartPosition, ...]) -> str:
    return ", ".join(map(str, places))


def _refuse_place(piece: Piece, place: PartPosition) -> Sentence:
    word = next((one.verdict for one in piece.filled if one.place == place), None)
    if place not in piece.places:
        what = Sentence("is no place of the plan")
    elif word is not None:
        what = Sentence(f"was pressed before ({word})")
    else:
        what = Sentence("comes later")
    return Sentence(
        f"{place} {what}; select and press {_list(piece.expected)} of this piece, or begin the next piece"
    )


def _describe(config: Config) -> str:
    """Say how a piece begins. Errors: ConfigError where nobody can begin one after one that was left unfinished."""
    commands, overview = config.commands, config.overview
    has_page = any(
        sink.plugin == "page" and {"token_file", "token_variable"} & sink.options.keys()
        for sink in config.sinks
    )
    served = {*commands.unsigned, *commands.signed, *(commands.page if has_page else ())}
    ways = {
        f"`{BEGIN}`": BEGIN in served,
        "the trigger of a PLC": config.handshake is not None,
        "the code on it": overview is not None and overview.reads_pieces,
    }
    known = [way for way, is_open in ways.items() if is_open]
    if not known:
        raise ConfigError(
            "piece: after a piece that was left unfinished the next one is begun by a person or a program, and nobody "
            f"may: name {BEGIN} in [commands] under signed or unsigned, give the sink `page` a token, let a PLC do it "
            "([handshake]), or read the pieces' ids with the group `piece` of overview.part_pattern"
        )
    return f"a piece begins with {', '.join(known)}, or with its first judged press"
