"""A second press of the same piece, where it is expected to pay: asked for, waited for, and decided together with the
first. The rule is in `edge.core.press_again`."""

import logging
from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from edge.core.contact.events import PressSettled
from edge.core.ports import Clock
from edge.core.press import AGREED, Again, Press
from edge.core.press_again import (
    Costs,
    Plan,
    SeenScores,
    is_asked,
    score_both,
    second_verdict,
    unsure,
)
from edge.core.registration.pose import warp
from edge.core.sentence import Sentence
from edge.core.verdict import Blame, Kind
from edge.messaging.result_payload import PressAgainPart
from edge.model.again_facts import again_sentence, plan_for
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.press_stage import Alarms, Mounted, PressStage, StageParts
from edge.store.gel_ledger import GelRecord
from edge.store.pieces import read_asked

__all__ = ["PressAgain", "find_seen"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _First:
    """A press that a second one was asked for."""

    score: float
    due_ns: int
    press_id: str
    piece_names: tuple[Set[str], ...]
    seen: SeenScores | None
    """Where it shows its score, on the part."""
    blame: Blame | None


class PressAgain(PressStage):
    """Asks for second presses. The press that comes within the time after one that was asked for is taken for the same
    piece. within_s: how long a second press is waited for."""

    def __init__(self, costs: Costs, within_s: float, clock: Clock, alarms: Alarms) -> None:
        self._costs, self._within_s, self._clock, self._alarms = costs, within_s, clock, alarms
        self._plan: Plan  # `use` comes before the first press
        self._bundle: Bundle | None = None
        self._first: _First | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        table = parts.config.press_again
        costs = Costs(table.missed_defect, table.false_alarm, table.press, table.defect_rate)
        stage = cls(costs, table.within_s, parts.clock, parts.alarms)
        if (press_id := parts.store.read("looking for a press that waits", read_asked)) is not None:
            why = Sentence("the station was restarted")
            stage._say_missed(press_id, Sentence(f"is not waited for any more: {why}"))
        return stage

    def mount(self, gel: GelRecord) -> None:
        """Wait for no second press on another gel."""
        self.drop("the gel was replaced")

    def use(self, inspector: Inspector) -> None:
        """Ask by the costs of this bundle. A press that was asked for does not count any more."""
        bundle = inspector.bundle
        self.drop(f"{bundle.manifest.part}/{bundle.manifest.position} is inspected now")
        if bundle is self._bundle:
            return
        self._bundle, self._plan = bundle, plan_for(bundle.manifest, self._costs)
        level = logging.WARNING if self._plan.bound is None else logging.INFO
        log.log(level, "one more press of a piece, %s: %s", bundle.where, again_sentence(self._plan))

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Return it unsure where a second press is asked for, or decided together with the first."""
        if press.label is not None:
            return press  # a master piece and a step of a study are no pieces that wait
        self._alarms.say("press_again", None)
        self.turn(None)
        names = zip(self._first.piece_names, press.piece_names, strict=True) if self._first else ()
        if any(first and now and not first & now for first, now in names):
            self.drop(Sentence("another piece is pressed"))
        decided = self._ask(press) if self._first is None else self._decide_second(press, self._first)
        return decided.distrust()

    def fields(self, press: Press) -> Mapping[str, Any]:
        again = press.again
        if again is None:
            return {}
        part = PressAgainPart(
            is_asked=again.is_asked,
            second_of=again.second_of or None,
            first_score=again.first_score,
            own_score=again.own_score,
            reason=again.reason,
        )
        return {"press_again": part}

    def drop(self, why: str) -> None:
        """A press that was asked for is not waited for any more."""
        self._missed(Sentence(f"is not waited for any more: {why}"))

    def turn(self, mounted: Mounted | None) -> None:
        """Say it when a press that was asked for did not come in time."""
        if self._first is not None and self._clock.monotonic_ns() > self._first.due_ns:
            self._missed(Sentence(f"did not come within {self._within_s:g} s"))

    def _missed(self, what: str) -> None:
        first, self._first = self._first, None
        if first is not None:
            self._say_missed(first.press_id, what)

    def _say_missed(self, press_id: str, what: str) -> None:
        self._alarms.say(
            "press_again",
            Sentence(
                f"the second press after press {press_id} {what}; its verdict stays unsure: "
                "treat the piece as not inspected, or press it twice again"
            ),
            "warning",
        )

    def _ask(self, press: Press) -> Press:
        verdict = press.verdict
        if verdict is None or not is_asked(verdict, self._plan.bound) or verdict.score is None:
            return press
        due_ns, seen = self._due_ns(), find_seen(press)
        self._first = _First(verdict.score, due_ns, press.press_id, press.piece_names, seen, press.blame)
        reason = Sentence(
            f"the score {verdict.score:.4g} lies up to {self._plan.bound:.4g}, where one more press should pay; "
            "press the same piece again, a little shifted"
        )
        return replace(press, verdict=unsure(verdict), again=Again(reason, True, bound=self._plan.bound))

    def _decide_second(self, press: Press, first: _First) -> Press:
        """A second press without a score is asked for once more."""
        verdict = press.verdict
        if verdict is None or verdict.score is None or self._bundle is None:
            self._first = replace(first, due_ns=self._due_ns())
            reason = Sentence("this second press has no score; press the same piece once more")
            return replace(press, again=Again(reason, True, first.press_id, first.score))
        self._first = None
        manifest, both = self._bundle.manifest, self._score_both(press, first)
        lower = min(first.score, verdict.score)
        reason = Sentence(f"decided by the lower score of two presses, {lower:.4g}")
        again = Again(reason, False, first.press_id, first.score)
        if both is not None:
            reason = Sentence(f"decided by what both presses show at one place of the part, {both:.4g}")
            level = AGREED * manifest.threshold.value
            again = replace(again, reason=reason, own_score=verdict.score, shown_from=level)
            if press.scars and first.blame and verdict.kind is Kind.PASS:  # the first one alone was looked at
                press = replace(press, scars=replace(press.scars, blame=first.blame))
        decided = second_verdict(verdict, first.score, both, manifest.decide)
        return replace(press, verdict=decided, again=again)

    def _score_both(self, press: Press, first: _First) -> float | None:
        """Return what both show at one place; None where places cannot be compared, and where the second press lies
        above the bound: a first one fails there."""
        second, score, bound = find_seen(press), press.score, self._plan.bound
        if first.seen is None or second is None or score is None or bound is None or score > bound:
            return None
        return score_both(first.seen, second)

    def _due_ns(self) -> int:
        return self._clock.monotonic_ns() + round(self._within_s * 1e9)


def find_seen(press: Press) -> SeenScores | None:
    """Bring what a press shows to the places of the part. None where it has no pose, where it may lie in
    another, where none of it was judged, where its score is not that of a place, such as of missing relief, and where
    the threshold is not above 0, so that it has no share."""
    placed, shown, verdict = press.registered, press.score_map, press.verdict
    if placed is None or not placed.is_unique or shown is None or not press.is_of_place:
        return None
    if verdict is None or not (verdict.threshold or 0.0) > 0:
        return None
    is_judged, masked = placed.seen, press.scars.masked if press.scars else None
    if masked is not None:
        is_judged = is_judged & (warp(masked.astype(np.float32), placed.pose) == 0)
    return SeenScores(warp(shown, placed.pose), is_judged) if is_judged.any() else None
