"""A shadow bundle: scored beside the one in use, never deciding, and taking its place only where it proves no worse."""

import logging
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Self

import numpy as np

from edge.background import Background
from edge.core.contact.events import PressSettled
from edge.core.errors import ArchiveError, NotScorable, PoseNotFound, StoreError
from edge.core.part_position import PartPosition
from edge.core.press import Press, ShadowVerdict
from edge.core.sentence import Sentence
from edge.core.shadow import LEAST_ON_NEW_GEL, JudgedTwice, Weighing
from edge.features.scars import mask_scars
from edge.messaging.command_payloads import NoArguments
from edge.messaging.result_payload import ShadowPart
from edge.model.inspector import Inspector
from edge.press_stage import Command, Data, Mounted, PressStage, StageParts
from edge.store.acts import TAKE_OVER, Act, find_unseen_takeover, was_adopted
from edge.store.database import open_read_only
from edge.store.gel_ledger import GelRecord
from edge.store.gel_proofs import GelBundle, unproven_since
from edge.store.person_verdicts import ask_again
from edge.store.press_archive import ArchiveFolder
from edge.store.shadow_verdicts import Unjudged, read_good_passes, read_judged_twice, read_learnt

__all__ = ["MOST_S", "Shadow"]

log = logging.getLogger(__name__)

MOST_S: Final = 1.0
"""What a shadow may take, or as long as the score of the bundle in use: verdicts wait for it."""

MOST_GOOD_PASSES: Final = 50
"""Good presses of before the shadow that the bundle in use passed, the newest, of which the shadow must fail none more:
some seconds."""

WEIGHED_EVERY_S: Final = 600.0
"""A shadow that may take over by itself is weighed after a press, so often at most."""

CLOSE_S: Final = 3.0


@dataclass(frozen=True)
class _Exchange:
    """A takeover, or the way back, that waits for a free gel."""

    part: PartPosition
    before: str
    after: str
    why: str


class Shadow(PressStage):
    """Scores each press of a part with the shadow of its position, too, and exchanges the two on request."""

    def __init__(self, parts: StageParts) -> None:
        self._selection, self._store, self._alarms = parts.selection, parts.store, parts.alarms
        self._clock, self._post = parts.clock, parts.post
        self._scored: tuple[Inspector, Press] | None = None
        self._exchange: _Exchange | None = None
        self._fault: tuple[Inspector, str] | None = None
        self._late: tuple[Inspector | None, int] = None, 0  # presses in a row for which it took too long
        self._is_by_itself = parts.config.inspection.takeover == "by itself"
        self._next_weighing_ns = -math.inf
        self.worker: Background[None] = Background("shadow", CLOSE_S)
        self._gel: tuple[str, str] | None = None
        self._has_looked = False  # for a takeover of before the start

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts)

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Score it with the shadow, beside the score that is there; the verdict stays as it is."""
        shadow, self._scored = self._selection.shadow, None
        if shadow is None or press.label is not None or press.rgb is None or press.score is None:
            return press
        if self._is_left_out(shadow):
            return press
        started_ns = self._clock.monotonic_ns()
        try:
            self._scored = shadow, _score(press, shadow, inspector)
            why = self._scored[1].error
        except Exception as error:  # nothing of a bundle that decides nothing may stop an inspection
            log.exception("the shadow failed")
            self._scored, why = (shadow, Press(error=repr(error))), f"{error!r:.200}"
        took_s = (self._clock.monotonic_ns() - started_ns) / 1e9
        late = self._judge_time(shadow, took_s, inspector)
        self._fault = late or ((shadow, Sentence(f"gave no score: {why}")) if why else None)
        return replace(press, latency_ms={**press.latency_ms, "shadow": took_s * 1e3})

    def _judge_time(
        self, shadow: Inspector, took_s: float, inspector: Inspector
    ) -> tuple[Inspector, str] | None:
        """Leave out a shadow that the verdicts of two presses in a row have waited for, longer than it may take."""
        most_s = max(MOST_S, inspector.took_s)
        is_late = took_s > most_s
        self._late = (shadow, self._late[1] + 1 if self._late[0] is shadow else 1) if is_late else (None, 0)
        if not self._is_left_out(shadow):
            return None
        return shadow, Sentence(
            f"is left out, for it took {took_s:.1f} s, at most {most_s:.1f} s are allowed, and each verdict waits for "
            "it: fit one with a faster method or a smaller bank"
        )

    def _is_left_out(self, shadow: Inspector) -> bool:
        return self._late[0] is shadow and self._late[1] >= 2

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """Return it with what the shadow says, without the places that were not judged."""
        if self._scored is None:
            return press
        (shadow, scored), self._scored = self._scored, None
        if press.scars is not None and scored.score_map is not None:
            scored = mask_scars(scored, press.scars, shadow.bundle)
        limit = shadow.bundle.manifest.threshold.value
        ids = shadow.bundle.digest, press.bundle_id
        return replace(press, shadow=ShadowVerdict(*ids, scored.word, scored.score, limit))

    def start(self) -> None:
        if self._is_by_itself:
            self.worker.start()

    def record(self, press: Press, gel: GelRecord) -> None:
        """Weigh the shadow on another thread, where it may take over by itself."""
        ids, shadow, now_ns = self._ids(), self._selection.shadow, self._clock.monotonic_ns()
        has_taken_over = self._selection.instead_of is not None
        if not self._is_by_itself or ids is None or shadow is None or has_taken_over:
            return
        if now_ns >= self._next_weighing_ns and not self.worker.is_busy:
            self._next_weighing_ns = now_ns + WEIGHED_EVERY_S * 1e9
            self.worker.ask(partial(self._adopt_by_itself, *ids, shadow))

    def close(self) -> None:
        self.worker.close()

    def fields(self, press: Press) -> Mapping[str, Any]:
        return {} if press.shadow is None else {"shadow": ShadowPart(**vars(press.shadow))}

    def turn(self, mounted: Mounted | None) -> None:
        """Exchange the bundles where that was asked for, while nothing is pressed. Errors: StoreError."""
        if not self._has_looked:
            self._say_earlier()
            self._has_looked = True
        faults = [*self._selection.shadow_faults]
        if self._fault is not None and self._fault[0] is self._selection.shadow:
            faults.append(Sentence(f"the shadow of {self._selection.part} {self._fault[1]}"))
        sentence = "; ".join(faults) or None
        self._alarms.say(
            "shadow", sentence and Sentence(f"{sentence}; presses are inspected without it"), "warning"
        )
        self._gel = None if mounted is None else (mounted.serial, mounted.gel_id)
        wish = self._exchange
        if wish is None or (mounted is not None and mounted.has_contact):
            return
        if self._selection.inspector.bundle.digest == wish.after:  # asked for twice
            self._exchange = None
            return
        if self._ids() == (wish.part, wish.before, wish.after):
            why = Act(
                self._clock.time_ns(),
                "the gateway",
                TAKE_OVER,
                arguments=wish.part._asdict(),
                outcome="done",
                before={"bundle_id": wish.before},
                after={"bundle_id": wish.after, "why": wish.why},
            )
            self._selection.exchange(why)
            text = _describe(why)
        else:
            text = Sentence(
                f"bundle {wish.after[:12]} has not taken over: another part or bundle is in use; ask again"
            )
        self._exchange = None
        log.warning("%s", text)
        self._alarms.say("takeover", text, "warning")

    def _say_earlier(self) -> None:
        """Say a takeover of before the start that nobody has acknowledged, unless its part is inspected otherwise."""
        takeover = self._store.read("reading the newest takeover", find_unseen_takeover)
        if takeover is None:
            return
        in_use = self._selection.inspector.bundle.digest
        is_selected = takeover.arguments == self._selection.part._asdict()
        if not is_selected or (takeover.after or {}).get("bundle_id") == in_use:
            self._alarms.say("takeover", _describe(takeover), "warning")

    def _ids(self) -> tuple[PartPosition, str, str] | None:
        """Give the part inspected now, its bundle and the shadow; None without one."""
        shadow = self._selection.shadow
        in_use = self._selection.inspector.bundle.digest
        return None if shadow is None else (self._selection.part, in_use, shadow.bundle.digest)

    def _adopt(self, arguments: NoArguments) -> Any:
        ids, shadow = self._ids(), self._selection.shadow
        if ids is None or shadow is None:
            why = "; ".join(self._selection.shadow_faults) or "name one under inspection.shadows, and reload"
            raise ValueError(f"there is no shadow of {self._selection.part}: {why}")
        if self._selection.instead_of is not None:
            raise ValueError(
                f"the shadow of {ids[0]} has taken over already; restore_bundle brings the configured bundle back"
            )
        return partial(self._adopt_if_no_worse, *ids, shadow)

    def _adopt_if_no_worse(
        self, part: PartPosition, in_use: str, other: str, shadow: Inspector, *, is_by_itself: bool = False
    ) -> Data:
        """Weigh the two, while the loop goes on. Errors: ValueError where the shadow may not take over; StoreError."""
        weighing = replace(self._weigh(part, in_use, other, shadow), is_by_itself=is_by_itself)
        doubts = "; ".join(weighing.doubts())
        refusals = weighing.refusals(has_promise=shadow.bundle.manifest.threshold.n > 0)
        if refusals:
            blocking = [*weighing.lost, *weighing.new_alarms]
            again = ask_again(self._store, blocking, "the gateway", self._clock.time_ns())
            refusals += filter(None, [again])
            raise ValueError(
                "; ".join([f"bundle {other[:12]} does not take over", *refusals, *filter(None, [doubts])])
            )
        why = "; ".join(filter(None, (weighing.describe(), doubts)))
        self._post(partial(self._wish_for, _Exchange(part, in_use, other, why)))
        return {"bundle_id": other, "instead_of": in_use, "why": why, "is_waiting": True}

    def _weigh(self, part: PartPosition, in_use: str, other: str, shadow: Inspector) -> Weighing:
        """Compare the two by the presses that both judged, or judge now from the archive. Errors: StoreError."""
        with open_read_only(self._store.path, "weighing a shadow") as connection:
            learnt = read_learnt(connection, shadow.bundle.manifest.provenance.presses)
            of_gel = [press_id for press_id, gel in learnt.items() if gel == self._gel]
            is_unproven = (
                self._gel is not None
                and unproven_since(connection, GelBundle(*self._gel, in_use)) is not None
            )
            is_new_gel = is_unproven and len(of_gel) >= LEAST_ON_NEW_GEL
            passes: Collection[str] = ()
            if self._gel is not None and not is_new_gel:
                passes = read_good_passes(connection, part, self._gel, MOST_GOOD_PASSES)
            good = of_gel if is_new_gel else {*learnt, *passes}
            both, missing = read_judged_twice(connection, part, other, in_use, good)
        missing = [
            press
            for press in missing
            if is_new_gel or press.was_damaged or press.verdict != "pass" or press.press_id in passes
        ]
        more, unknown = self._judge_missing(missing, shadow, None if is_new_gel else in_use)
        return Weighing([*both, *more], unknown, is_new_gel=is_new_gel)

    def _adopt_by_itself(self, part: PartPosition, in_use: str, other: str, shadow: Inspector) -> None:
        """Let it take over where it may and was never taken back; else the log says why not."""
        try:
            if not self._store.read("reading takeovers", partial(was_adopted, bundle_id=other)):
                self._adopt_if_no_worse(part, in_use, other, shadow, is_by_itself=True)
        except (ValueError, StoreError) as refusal:
            log.info("%s", refusal)

    def _wish_for(self, exchange: _Exchange) -> None:
        self._exchange = exchange

    def _judge_missing(
        self, missing: list[Unjudged], shadow: Inspector, judged_by: str | None
    ) -> tuple[list[JudgedTwice], list[str]]:
        """Judge presses of before the shadow from the archive; return what damage is gone as sentences. judged_by: of
        good ones only those that this bundle judged, and not those that both pass."""
        from edge.features.black_box.replay import judge_as_then  # few stations have such damage

        archive = ArchiveFolder(self._store.path.with_suffix(".archive"))
        inspector: Inspector | None = None
        judged, unknown = list[JudgedTwice](), list[str]()
        for missing_press in missing:
            try:
                press = archive.press(missing_press.press_id, missing_press.evidence)
                is_kept = judged_by is None or missing_press.was_damaged
                if not is_kept and press.bundle_id != judged_by:
                    continue
                # The loop scores with the other one.
                inspector = inspector or Inspector(shadow.scorer.copy(), self._clock)
                now = judge_as_then(press, archive, inspector)
                words = missing_press.saying, missing_press.was_damaged
                if is_kept or (missing_press.verdict, now.word) != ("pass", "pass"):
                    judged.append(
                        JudgedTwice(missing_press.press_id, missing_press.verdict, now.word, *words)
                    )
            except ArchiveError as error:
                if missing_press.was_damaged:
                    unknown.append(
                        f"whether the shadow finds the damage of {missing_press.press_id} is not known: {error}"
                    )
        return judged, unknown

    def _restore(self, arguments: NoArguments) -> Any:
        ids, shadow = self._ids(), self._selection.shadow
        if ids is None or shadow is None or self._selection.instead_of is None:
            raise ValueError(
                f"no shadow has taken the place of the configured bundle of {self._selection.part}"
            )
        return partial(self._bring_back, *ids, shadow)

    def _bring_back(self, part: PartPosition, in_use: str, other: str, configured: Inspector) -> Data:
        """Bring the configured bundle back, and name the damage that it passes: nothing holds the way back up."""
        try:
            doubts = self._weigh(part, in_use, other, configured).doubts()
        except StoreError as error:
            doubts = [str(error)]
        why = "; ".join(["restore_bundle was asked for", *doubts])
        self._post(partial(self._wish_for, _Exchange(part, in_use, other, why)))
        return {"bundle_id": other, "instead_of": in_use, "why": why, "is_waiting": True}

    commands = (
        Command(
            "adopt_shadow",
            NoArguments,
            _adopt,
            "let the shadow of the part inspected now take the place of its bundle, once the gel is free. Refused "
            "where it promises no rate of false alarms, passes damage that was found, fails more of what people call "
            "good, or where too few presses show that it is no worse",
            "the bundle that inspects",
        ),
        Command(
            "restore_bundle",
            NoArguments,
            _restore,
            "bring the configured bundle back, whose place a shadow has taken, once the gel is free",
            "the bundle that inspects",
        ),
    )


def _describe(takeover: Act) -> Sentence:
    """Say which bundle inspects and why."""
    part, why = PartPosition(**takeover.arguments), (takeover.after or {}).get("why")
    before, after = (str((one or {}).get("bundle_id")) for one in (takeover.before, takeover.after))
    return Sentence(f"bundle {after[:12]} inspects {part} instead of {before[:12]}: {why}")


def _score(press: Press, shadow: Inspector, inspector: Inspector) -> Press:
    """Score the region of a press with a shadow, by what the bundle in use has computed where that is the same."""
    assert press.rgb is not None
    try:
        _follow_light(press, shadow, inspector)
        prepared = shadow.restore_light(shadow.bundle.prepare(press.rgb))
        if shadow.light == press.light:
            scored = shadow.scorer.score_beside(inspector.scorer, prepared, press.registered)
        else:  # it was fitted under another light
            scored = shadow.scorer.score_prepared(prepared)
        verdict = shadow.bundle.manifest.decide(scored.anomaly_score)
        return Press(verdict, score_map=scored.score_map)
    except (PoseNotFound, NotScorable) as error:
        return Press(error=str(error))


def _follow_light(press: Press, shadow: Inspector, inspector: Inspector) -> None:
    """Have the shadow follow the light that the press was scored under; it may be fitted under another one."""
    fits = [judge.bundle.free_reference for judge in (inspector, shadow)]
    shadow.new_gel = inspector.new_gel
    if fits[0] is not None and fits[1] is not None and np.array_equal(fits[0].view, fits[1].view):
        shadow.set_light(press.light)
    elif press.light is not None and fits[0] is not None:
        shadow.follow_light(press.light.undo(fits[0].view))
    else:
        shadow.follow_light(None if press.judged is None else press.judged.reference)
