"""A second press of the same piece, where it is expected to pay: asked for, waited for, and decided together with the
first. The rule is in `edge.core.press_again`."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from edge.core.contact.events import PressSettled
from edge.core.ports import Clock
from edge.core.press import Again, Press
from edge.core.press_again import Costs, Plan, is_asked, second_verdict, unsure
from edge.gateway.inspector import Inspector
from edge.gateway.masking import blinded
from edge.gateway.press_stage import Mounted, PressStage
from edge.model.bundle import Bundle
from edge.model.press_again_facts import again_sentence, plan_for
from edge.store.gel_ledger import GelRecord

__all__ = ["AgainRule", "PressAgain"]

log = logging.getLogger(__name__)

Say = Callable[[str | None], None]
"""Raises the alarm with this sentence, or clears it."""


@dataclass(frozen=True)
class AgainRule:
    """Configured: what presses cost, and how long a second one is waited for. is_on: False asks for none."""

    is_on: bool
    costs: Costs
    within_s: float


@dataclass(frozen=True)
class _First:
    """A press that a second one was asked for."""

    score: float
    due_ns: int
    press_id: str


class PressAgain(PressStage):
    """Asks for second presses. The press that comes within the time after one that was asked for is taken for the same
    piece."""

    def __init__(self, rule: AgainRule, clock: Clock, say: Say) -> None:
        self._rule, self._clock, self._say = rule, clock, say
        self._plan = Plan("no bundle")
        self._bundle: Bundle | None = None
        self._first: _First | None = None
        self._is_said = False

    def mount(self, gel: GelRecord) -> None:
        """Wait for no second press on another gel."""
        self.drop("the gel was replaced")

    def use(self, inspector: Inspector) -> None:
        """Ask by the costs of this bundle. A press that was asked for does not count any more."""
        bundle = inspector.bundle
        self.drop(f"{bundle.manifest.part}/{bundle.manifest.position} is inspected now")
        if not self._rule.is_on or bundle is self._bundle:
            return
        self._bundle, self._plan = bundle, plan_for(bundle.manifest, self._rule.costs)
        level = logging.WARNING if self._plan.bound is None else logging.INFO
        log.log(level, "one more press of a piece, %s: %s", bundle.where, again_sentence(self._plan))

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Return it unsure where a second press is asked for, or decided together with the first."""
        return blinded(self._decide(press))

    def _decide(self, inspection: Press) -> Press:
        if not self._rule.is_on or inspection.label is not None:
            return inspection  # also that of a master piece or of a study, which is no piece that waits
        self.turn(None)
        if self._is_said:
            self._is_said = False
            self._say(None)
        if self._first is not None:
            return self._second(inspection, self._first)
        return self._asked(inspection)

    def drop(self, why: str) -> None:
        """A press that was asked for is not waited for any more."""
        if self._first is not None:
            self._missed(f"is not waited for any more: {why}")

    def turn(self, mounted: Mounted | None) -> None:
        """Say it when a press that was asked for did not come in time."""
        if self._first is not None and self._clock.monotonic_ns() > self._first.due_ns:
            self._missed(f"did not come within {self._rule.within_s:g} s")

    def _missed(self, what: str) -> None:
        first, self._first = self._first, None
        self._is_said = True
        self._say(
            f"the second press after press {first.press_id if first else ''} {what}; its verdict stays unsure: treat "
            "the piece as not inspected, or press it twice again"
        )

    def _asked(self, inspection: Press) -> Press:
        verdict = inspection.verdict
        if verdict is None or not is_asked(verdict, self._plan.bound) or verdict.score is None:
            return inspection
        self._first = _First(verdict.score, self._due_ns(), inspection.press_id)
        reason = (
            f"the score {verdict.score:.4g} lies up to {self._plan.bound:.4g}, where one more press should pay; "
            "press the same piece again, a little shifted"
        )
        return replace(inspection, verdict=unsure(verdict), again=Again(reason, True, bound=self._plan.bound))

    def _second(self, inspection: Press, first: _First) -> Press:
        """A second press without a score is asked for once more."""
        verdict = inspection.verdict
        if verdict is None or verdict.score is None or self._bundle is None:
            self._first = replace(first, due_ns=self._due_ns())
            reason = "this second press has no score; press the same piece once more"
            return replace(inspection, again=Again(reason, True, first.press_id, first.score))
        self._first = None
        lower = self._bundle.manifest.decide(min(first.score, verdict.score))
        reason = f"decided by the lower score of two presses, {lower.score:.4g}"
        again = Again(reason, False, first.press_id, first.score)
        return replace(inspection, verdict=second_verdict(first.score, verdict, lower), again=again)

    def _due_ns(self) -> int:
        return self._clock.monotonic_ns() + round(self._rule.within_s * 1e9)
