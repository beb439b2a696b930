"""What people say of presses: an act of the ledger each, and the presses that a page asks about."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date
from functools import partial
from typing import Final, Self

from pydantic import Field, model_validator

from edge.clock import local_day
from edge.core.errors import ArchiveError
from edge.core.imaging.quality import Reason
from edge.core.person_verdict import (
    Asked,
    PersonVerdict,
    Saying,
    choose_questions,
    describe_escapes,
    find_broken_promise,
    is_called_damaged,
)
from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.core.shadow import describe_new_gel, describe_way
from edge.core.verdict import Kind
from edge.messaging.command_payloads import CommandArguments, PlainText
from edge.messaging.payload_base import PressId
from edge.messaging.status_payloads import Question, QuestionsPayload
from edge.press_stage import Command, Data, Mounted, PressStage, StageParts
from edge.store.acts import CONFIRM
from edge.store.gel_ledger import GelRecord
from edge.store.gel_proofs import GelBundle, unproven_since, used_since
from edge.store.person_verdicts import (
    AskedAgain,
    count_good,
    find_table,
    newest_acts,
    read_as_shadow,
    read_askable,
    read_passed,
    read_verdicts,
)
from edge.store.press_archive import ArchivedPress, ArchiveFolder

__all__ = ["PersonVerdicts"]

# New presses and answers are looked for this often.
LOOK_S: Final = 1.0

# Older presses are not asked for: nobody has the part at hand any more.
DAY_NS: Final = 86_400 * 10**9

# The newest presses among which is chosen.
MOST_REMEMBERED: Final = 2000


class ConfirmPressArguments(CommandArguments):
    """Of `cmd/confirm_press`. verdict: what a person says: `good`, `damaged`, `gel` (the gel, not the part) or
    `cannot_tell`. kind: of the damage."""

    press_id: PressId
    verdict: Saying
    kind: PlainText | None = Field(default=None, min_length=1, max_length=64)

    @model_validator(mode="after")
    def _kind_of_damage(self) -> Self:
        if self.kind is not None and self.verdict != "damaged":
            raise ValueError(f"kind is of a damage, and the verdict is {self.verdict}")
        return self


class PersonVerdicts(PressStage):
    """Takes what people say, asks for it, and says which damage has passed.

    Without the verb nobody could answer, and without the archive nobody could look, so nothing is asked.
    """

    def __init__(self, parts: StageParts) -> None:
        table, archive = parts.config.commands, parts.config.archive
        is_served = CONFIRM in (*table.unsigned, *table.signed, *table.page)
        self._per_day = parts.config.confirm.questions_per_day if is_served and archive.presses else 0
        self._store, self._announce, self._clock = parts.store, parts.announce, parts.clock
        self._alarms, self._selection = parts.alarms, parts.selection
        self._after = 0
        self._acts = (0, 0)
        self._presses: list[Asked] = []
        self._asked_again = AskedAgain()
        self._of_other_colours: set[str] = set()
        self._shown: tuple[object, ...] | None = None
        self._escapes: Sentence | None = None
        self._day: date | None = None
        self._had_gel = False
        self._next_look_ns = 0
        self._mounted: Mounted | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        stage = cls(parts)
        stage._show(0, [])  # a question of an earlier start is no longer asked
        return stage

    def turn(self, mounted: Mounted | None) -> None:
        """Say which damage has passed, and ask anew, when presses or answers have come. Errors: StoreError."""
        self._mounted = mounted
        now_ns = self._clock.monotonic_ns()
        if now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + round(LOOK_S * 1e9)
        acts = self._store.read("reading the newest acts", newest_acts)  # a pedal's word too is one
        is_new_word = acts != self._acts
        if is_new_word or self._escapes:
            self._say_escapes()
        today, has_gel = local_day(self._clock.time_ns()), mounted is not None
        # Also where nobody is asked: people may speak at a pedal, or over MQTT.
        if self._read() or is_new_word or (today, has_gel) != (self._day, self._had_gel):
            self._day, self._had_gel = today, has_gel
            self._ask(today, mounted)
        self._acts = acts

    def record(self, press: Press, gel: GelRecord) -> None:
        """Remember what was refused for its colours: on a new gel it is asked about."""
        if self._per_day and (press.reason or "").startswith(f"{Reason.OTHER_SENSOR}:"):
            self._of_other_colours.add(press.press_id)

    def _ask(self, today: date, mounted: Mounted | None) -> None:
        verdicts_by_press = self._read_said()
        of_today = {
            press_id
            for press_id, verdicts in verdicts_by_press.items()
            if any(local_day(verdict.time_ns) == today for verdict in verdicts)
        }
        answered = len(of_today)
        again = self._store.read("reading what is asked again", self._asked_again.read)
        most = max(0, self._per_day - answered)
        again, known = again[:most], {one.press_id for one in again} | verdicts_by_press.keys()
        new_gel_ns = None
        if mounted is not None:  # since when its bundle is used on a gel on which it is not proven
            key = GelBundle(mounted.serial, mounted.gel_id, mounted.bundle_id)
            new_gel_ns = self._store.read("reading the proof on this gel", partial(unproven_since, key=key))
        left = most - len(again)
        questions = [*again, *choose_questions(self._presses, known, left, new_gel_ns, of_today)]
        if (answered, questions) != self._shown:
            self._show(answered, questions)
        if mounted is not None:
            is_proven = new_gel_ns is None  # else the alarm `gel_proof` says the same
            broken = self._find_broken_promise(mounted, verdicts_by_press) if is_proven else None
            self._alarms.say("false_alarms", broken, "warning")

    def _say_escapes(self) -> None:
        """Say which presses are damaged that passed, or that pass the bundle in use, which was their shadow, by what
        people said in the last day."""
        damaged = [press_id for press_id, words in self._read_said().items() if is_called_damaged(words)]
        passed = self._store.read("looking for what passed", partial(read_passed, press_ids=damaged))
        in_use = self._selection.inspector.bundle.digest
        query = partial(read_as_shadow, press_ids=damaged, bundle_id=in_use)
        now = self._store.read("looking for what passes now", query)
        passing = [press_id for press_id, verdict in now.items() if verdict == Kind.PASS.value]
        self._escapes = describe_escapes(passed, passing)
        self._alarms.say("escape", self._escapes, "warning")

    def _read_said(self) -> dict[str, list[PersonVerdict]]:
        since_ns = self._clock.time_ns() - DAY_NS
        return self._store.read("reading what people said", partial(read_verdicts, since_ns=since_ns))

    def _find_broken_promise(
        self, mounted: Mounted, said: Mapping[str, Sequence[PersonVerdict]]
    ) -> Sentence | None:
        """Say where the bundle in use fails more sound presses of this gel than it promises."""
        limit = self._selection.inspector.bundle.manifest.threshold
        key = GelBundle(mounted.serial, mounted.gel_id, mounted.bundle_id)
        since_ns = self._store.read("reading when the bundle was first used", partial(used_since, key=key))
        if not limit.n or since_ns is None:
            return None
        judged = [
            press
            for press in self._presses
            if (press.part, press.position) == mounted.part
            and press.time_ns >= since_ns
            and press.score_ratio is not None
        ]
        return find_broken_promise(judged, said, max(limit.alpha, limit.alpha_floor))

    def _show(self, answered: int, questions: list[Asked]) -> None:
        self._shown = answered, questions
        asked = tuple(
            Question(**vars(question), time_ms=question.time_ns // 1_000_000) for question in questions
        )
        payload = QuestionsPayload(
            time_ns=self._clock.time_ns(), per_day=self._per_day, answered_today=answered, presses=asked
        )
        self._announce(payload.message())

    def _read(self) -> bool:
        """Read the presses since the last look, and forget those of yesterday. Return whether there are others."""
        query = partial(read_askable, after=self._after, most=MOST_REMEMBERED)
        newest = self._store.read("reading the newest presses", query)
        self._after = max([self._after, *(number for number, _ in newest)])
        new = [
            press
            for _, press in newest
            if press.score_ratio is not None or press.press_id in self._of_other_colours
        ]
        self._of_other_colours.clear()
        now_ns, before = self._clock.time_ns(), self._presses
        recent = [one for one in (*before, *new) if 0 <= now_ns - one.time_ns < DAY_NS]
        self._presses = sorted(recent, key=lambda one: one.time_ns)[-MOST_REMEMBERED:]
        return self._presses != before

    def _confirm(self, arguments: ConfirmPressArguments) -> Data:
        """Say what is known of the press; the request itself is the record. Errors: ValueError, StoreError."""
        press_id = arguments.press_id
        table = self._store.read("looking for a press", partial(find_table, press_id=press_id))
        if table is None:
            raise ValueError(
                f"press {press_id} is not in the history of this station: it is another station's, or too old"
            )
        if table.name != "presses":
            raise ValueError(
                f"press {press_id} is of a master piece or of a study: what it is, is known; confirm presses of parts"
            )
        verdicts = self._store.read("reading what people said", partial(read_verdicts, press_id=press_id))
        earlier = verdicts.get(press_id, [])
        archive, press = ArchiveFolder(self._store.path.with_suffix(".archive")), None
        with suppress(ArchiveError):
            press = archive.press(press_id, table.evidence)
        remarks: list[Sentence] = []
        if arguments.verdict == "good":
            remarks = self._say_way(press_id, table.verdict)
        elif arguments.verdict == "damaged" and press is not None:
            remarks = self._say_unknown(press)
        return {
            "press_id": press_id,
            "verdict": table.verdict,
            "is_archived": press is not None and archive.has_all(press),
            "earlier": [f"{one.person}: {one.saying}" for one in earlier],
            "remarks": remarks,
        }

    def _say_way(self, press_id: str, verdict: str | None) -> list[Sentence]:
        """Say what must come until a good press passes that did not; nothing of one that passed where the bundle is
        proven."""
        mounted = self._mounted
        if mounted is None:
            return []
        key = GelBundle(mounted.serial, mounted.gel_id, mounted.bundle_id)
        since_ns = self._store.read("reading when the bundle was first used", partial(used_since, key=key))
        unproven_ns = self._store.read("reading the proof on this gel", partial(unproven_since, key=key))
        query = partial(count_good, part=mounted.part, gel=key[:2], since_ns=since_ns or 0, press_id=press_id)
        good, failed = self._store.read("counting what people call good", query)
        if unproven_ns is not None:
            return [describe_new_gel(good)]
        has_shadow = self._selection.shadow is not None
        return [] if verdict == Kind.PASS.value else [describe_way(failed, has_shadow=has_shadow)]

    def _say_unknown(self, press: ArchivedPress) -> list[Sentence]:
        """Say of a damage that another bundle found where nobody knows whether the one in use finds it."""
        bundle_id = self._selection.inspector.bundle.digest
        is_of_part = (press.part, press.position) == self._selection.part
        if press.verdict == Kind.PASS.value or press.bundle_id == bundle_id or not is_of_part:
            return []
        query = partial(read_as_shadow, press_ids=[press.press_id], bundle_id=bundle_id)
        if self._store.read("reading what the bundle said", query):
            return []
        return [
            Sentence(
                "another bundle found this damage; whether the one that inspects now finds it is not known: `gelgate "
                "bundle teach` tells"
            )
        ]

    commands = (
        Command(
            CONFIRM,
            ConfirmPressArguments,
            _confirm,
            "a person says what a press was, beside the verdict of the station, which stays; the newest word of each "
            "person counts, and where two contradict each other nobody can tell. `earlier`: what was said before; "
            "`is_archived`: whether the press can still be replayed; `remarks`: what must come until a good one passes",
            "what the bundle in use is trusted with on a new gel",
        ),
    )
