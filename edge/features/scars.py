"""The scars of the mounted gel: each press is judged with them, and they are kept across restarts."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.events import Event, Findings, PressBegan, PressSettled, ReferenceCorrected
from edge.core.contact.press_detector import Look
from edge.core.contact.reference import View
from edge.core.contact.relief import reach_beside_marks
from edge.core.gel_scars.free_change import FreeViews
from edge.core.gel_scars.gel_scars import GelScars, Judged, Repeated
from edge.core.gel_scars.press import ScoredPress, measure_moves, without_marks
from edge.core.gel_scars.record import ScarRecord
from edge.core.imaging.frames import CameraFrame
from edge.core.press import Press, ScarFindings
from edge.core.printable import score_texts
from edge.core.registration.pose import warp
from edge.core.sentence import Sentence
from edge.core.verdict import Blame, Cause, Kind
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.press_stage import PressStage, StageParts
from edge.store.gel_files import GelFiles
from edge.store.gel_ledger import GelRecord

__all__ = ["ScarWatch", "mask_scars"]

# A new scar is kept at once, everything else of the record after this number of presses.
_KEPT_EVERY: Final = 16

_NOWHERE: Final = Blame(
    Cause.UNSURE, "no place of the score map is above the limit, so no place of the gel can be looked at"
)


class ScarWatch(PressStage):
    """Finds whether gel or part is the cause, and leaves known scars out. It says what is wrong with the gel."""

    def __init__(self, parts: StageParts) -> None:
        table, self._alarms = parts.config.gel, parts.alarms
        self._folder = GelFiles(parts.config.store.path.with_suffix(".references"))
        self._is_masking, self._most_blind_share = table.scars == "masked", table.most_blind_share
        self._free = FreeViews()
        self._left: View | None = None
        self._is_left_known = True
        self._scars, self._serial, self._gel_id, self._unsaved = GelScars(), "", "", 0
        self._blind: Sentence | None = None
        self._mark: Sentence | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Scars are kept next to the database."""
        return cls(parts)

    def mount(self, gel: GelRecord) -> None:
        """Read the record of this gel, and keep that of the one before; an unknown gel has none."""
        self._save()
        self._serial, self._gel_id = gel.serial, gel.gel_id
        self._read()

    def _read(self) -> None:
        self._blind = self._mark = None
        self._say()
        self._scars = GelScars(self._folder.load(self._serial, self._gel_id, "scars", ScarRecord.from_file))
        self.relearn()

    def relearn(self) -> None:
        self._free.clear()
        self._left = None

    def see(self, event: Event) -> None:
        """Look at the free gel as a press begins. Forget what was found with a first picture that proved wrong."""
        if isinstance(event, PressBegan):
            self._scars.is_fresh = self._free.is_fresh
            self._scars.see_free(self._free.mean() if self._is_left_known else None, self._left)
        if isinstance(event, ReferenceCorrected):
            self._folder.forget(self._serial, self._gel_id, "scars")
            self._read()

    def learn(self, first: View | None) -> None:
        self._scars.first = first

    def look(self, look: Look) -> None:
        if look.level is not None:
            # Just after an interruption the table's state is that of before: a part may lie there by now.
            view = None if look.phase == "unseen" else look.level
            self._free.see(look.state, view, look.timestamp_ns, is_faint=look.phase == "touching")

    def expect(self, frame: CameraFrame, examined: Press) -> None:
        """Look for the marks of the free gel ahead, where the press will need a cause."""
        if examined.score is not None and examined.word != Kind.PASS.value:
            self._scars.find_marks(self._free.mean(), self._left)

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Return it with its cause, and without the places that are known to be scarred.

        One piece that is pressed again and again at one place would look like a scar, so master pieces and studies are
        left out.
        """
        findings = None if settled is None else settled.findings
        if findings is None:  # refused, or never at rest: what it leaves on the gel would look like marks
            self._is_left_known = False
            return press
        is_left_known, self._is_left_known = self._is_left_known, True
        if press.label is not None:
            self._left = findings.imprint
            return press
        return self._judge(press, inspector, findings, self._free.mean() if is_left_known else None)

    def record(self, press: Press, gel: GelRecord) -> None:
        """Say what is wrong with the gel, and keep the record of the scars where it is due: a result waits neither for
        a message nor for a file. Never raises."""
        self._say()
        self._save()

    def close(self) -> None:
        """Keep what a press that the store refused has added. Never raises."""
        self._save()

    def fields(self, press: Press) -> Mapping[str, Any]:
        scars, blame = press.scars, press.blame
        if scars is None:
            return {}
        return {
            "cause": blame.cause if blame else None,
            "cause_text": blame.why if blame else None,
            "blind_area_mm2": round(scars.blind_mm2, 4),
            "blind_share": round(scars.blind_share, 4),
            "unmasked_score": scars.score,
        }

    def _say(self) -> None:
        """Tell that scars hide too much of what is pressed, and that one place exceeds again and again."""
        self._alarms.say("gel_scar", self._blind)
        self._alarms.say("gel_mark", self._mark, "warning")

    def _judge(self, inspection: Press, inspector: Inspector, found: Findings, free: View | None) -> Press:
        left, self._left = self._left, found.imprint
        press = _press_of_rules(inspection, inspector, found)
        if press is None:
            return inspection
        can_mask, is_above = inspection.is_of_place, (press.score_map > press.limit).any()
        if is_above:  # no other press is asked for it
            place = press.region, press.size, press.mm_per_pixel
            press = replace(press, moved_mm=measure_moves(inspection.registered, *place))
        if can_mask and (is_above or self._scars.lasting_specks.any()):
            press = replace(press, reach=self._reach(press, inspection, inspector, found, free))
        is_masking = self._is_masking and can_mask
        judged = self._scars.judge(press, free, left, is_masking=is_masking)
        self._mark = None if judged.repeated is None else _repeated(judged.repeated)
        self._unsaved = _KEPT_EVERY if judged.is_new else self._unsaved + 1
        return mask_scars(inspection, self._findings(inspection, judged), inspector.bundle)

    def _reach(
        self, press: ScoredPress, inspection: Press, inspector: Inspector, found: Findings, free: View | None
    ) -> NDArray[np.bool_] | None:
        """Return where in the view the part is or should be; None where the second is not known. free: the gel just
        before."""
        if inspector.expected is None:
            return None
        placed, usual = inspection.registered, inspector.expected.astype(np.float32)
        here = usual if placed is None else warp(usual, placed.pose.inverse())
        before = found.free if free is None else free
        reached = reach_beside_marks(found.mask, found.relief, found.level, before, self._scars.near_marks)
        return reached | (press.in_view(here) > 0)

    def _save(self) -> None:
        if self._unsaved >= _KEPT_EVERY and self._scars.record.planes.any():
            self._folder.save(self._serial, self._gel_id, "scars", self._scars.record.planes)
            self._unsaved = 0

    def _findings(self, inspection: Press, judged: Judged) -> ScarFindings:
        """Say what the scars hide, and why the press is not passed where it is not."""
        is_too_blind = judged.blind_share > self._most_blind_share
        self._blind = _too_blind(self._gel_id, judged, self._most_blind_share) if is_too_blind else None
        if not judged.masked.any() or inspection.verdict is None:
            return ScarFindings(judged.blame or _NOWHERE)
        return ScarFindings(
            judged.blame or (Blame(Cause.GEL, self._blind) if self._blind else _NOWHERE),
            judged.masked,
            judged.blind_mm2,
            judged.blind_share,
            is_too_blind,
            inspection.verdict.score,
        )


def mask_scars(press: Press, findings: ScarFindings, bundle: Bundle) -> Press:
    """Judge it without the masked places, which have the lowest score of the map.

    Errors: ValueError for a press without a score.
    """
    verdict, score_map = press.verdict, press.score_map
    if verdict is None or score_map is None:
        raise ValueError("a press without a score has no places to leave out")
    if findings.masked is not None:
        score_map = np.where(findings.masked, score_map.min(), score_map)
        verdict = bundle.manifest.decide(float(score_map.max()))
    return replace(press, verdict=verdict, score_map=score_map, scars=findings).distrust()


def _too_blind(gel_id: str, judged: Judged, most: float) -> Sentence:
    blind_share, most_blind_share = score_texts(judged.blind_share, most, 0, "%")
    return Sentence(
        f"{judged.blind_mm2:.1f} mm2 of the contact, {blind_share} of it, lie under scars of gel "
        f"{gel_id} and are not judged, at most {most_blind_share} are accepted; wipe the gel, or mount a "
        "new one and run `gelgate gel replace`"
    )


def _repeated(place: Repeated) -> Sentence:
    at = Sentence(f"{place.x_mm:.1f} mm from the left and {place.y_mm:.1f} mm from the top of the picture")
    if place.is_outside:
        return Sentence(
            f"the gel shows the same mark {at} in five presses in a row, where the part does not reach, so nothing "
            "fails by it; wipe the gel there, or change it"
        )
    return Sentence(
        f"five presses in a row exceed the limit at the same place of the gel, {at}: a mark of the gel, or the same "
        "damage of each part; wipe the gel there and press a part that is known to be good; if it fails there too, "
        "change the gel"
    )


def _press_of_rules(inspection: Press, inspector: Inspector, found: Findings) -> ScoredPress | None:
    """Return what the rules of scars read; None for a press without a score."""
    verdict, placed, rgb = inspection.verdict, inspection.registered, inspection.rgb
    if rgb is None or inspection.score_map is None or verdict is None or verdict.threshold is None:
        return None
    bundle = inspector.bundle
    size, region = bundle.profile.size, bundle.region
    return ScoredPress(
        inspection.score_map,
        verdict.threshold - (verdict.tolerance or 0.0),
        region,
        size,
        bundle.profile.mm_per_pixel,
        found.mask,
        None if placed is None else placed.unseen_in_press,
        without=lambda change: inspector.score_map(without_marks(rgb, change, size, region)),
    )
