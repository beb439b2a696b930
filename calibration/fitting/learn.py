"""What a bundle may learn from operation: archived presses of its part of which people said what they were.

Parts that are good are learnt; parts that are damaged are kept apart, to show that the new bundle loses none of them.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from calibration.fitting.carry import MOST_CHANGE
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.progress import Report
from edge.clock import SystemClock
from edge.core.arrays import Mask
from edge.core.errors import ArchiveError, FitError, NotScorable, PoseNotFound
from edge.core.imaging.decode import decode
from edge.core.imaging.followed_light import FollowedLight
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import kind
from edge.core.imaging.quality import Reason
from edge.core.imaging.sensor_check import colour_cells, is_other_kind
from edge.core.part_position import PartPosition
from edge.core.person_verdict import PersonVerdict, settle
from edge.core.press import Press
from edge.core.shadow import LEAST_ON_NEW_GEL, is_more
from edge.features.black_box.replay import judge_as_then
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.database import open_read_only
from edge.store.gel_proofs import GelBundle, unproven_gel
from edge.store.person_verdicts import read_verdicts
from edge.store.press_archive import ArchivedPress, ArchiveFolder

__all__ = [
    "Comparison",
    "ConfirmedPresses",
    "join_pieces",
    "judge_presses",
    "leave_out_places",
    "read_confirmed",
    "score_refused",
    "write_picture",
    "write_pictures",
]

# Presses that change and are named.
MOST_NAMED: Final = 8

# Presses of which nobody spoke that both bundles judge: some ten seconds.
MOST_OTHERS: Final = 200

# A part that people call good, this far beyond the threshold, would widen the bank to what it should find: a picture of
# it among the nominal presses says so on purpose. On a new gel all presses score higher, so it is this far beyond their
# median.
FARTHEST: Final = 2.0


@dataclass(frozen=True)
class ConfirmedPress:
    """A press with what people said of it, and the camera's bytes."""

    press: ArchivedPress
    said: PersonVerdict
    frame: bytes
    piece: str
    """What the presses of one piece have in common."""
    unjudged: Mask | None = None
    """The places at which the station did not judge it, bool (h, w) of the region; None for none."""
    refused_score: float | None = None
    """The score that the bundle would have given, had it not refused it for its colours."""

    @property
    def score(self) -> float | None:
        """Its score, also where it was refused for its colours."""
        return self.press.score if self.refused_score is None else self.refused_score

    @property
    def ratio(self) -> float:
        """Score by threshold; 0 where there is none."""
        return (self.score or 0.0) / (self.press.threshold or math.inf)

    def describe(self) -> str:
        """Name it for a person: id, score, and who said what."""
        ratio = f", {self.ratio:.2f} of the threshold" if self.score is not None else ""
        what = " ".join(filter(None, (self.said.saying, self.said.kind)))
        return f"{self.press.press_id} ({self.press.verdict}{ratio}; {self.said.person}: {what})"


@dataclass
class ConfirmedPresses:
    """What people said of the presses of one part and position."""

    good: list[ConfirmedPress] = field(default_factory=list)
    damaged: list[ConfirmedPress] = field(default_factory=list)
    words: Counter[str] = field(default_factory=Counter)
    """How often each word holds."""
    left_out: list[str] = field(default_factory=list)
    """Presses that could have been used, with the reason why they are not."""
    new_gel: GelBundle | None = None
    """The mounted gel, where the bundle is not proven on it."""
    on_new_gel: set[str] = field(default_factory=set)
    """The ids of its presses."""
    others: list[ArchivedPress] = field(default_factory=list)
    """Archived presses of which nobody can tell, or that show the gel, and the newest ones of which nobody spoke."""
    doubted: set[str] = field(default_factory=set)
    """The ids of those that anybody ever called damaged, whatever was said later."""

    def add(self, one: ConfirmedPress) -> None:
        """Sort it in."""
        if one.said.saying == "damaged":
            self.damaged.append(one)
        elif one.said.saying != "good":
            self.others.append(one.press)
        elif one.score is None or not one.press.threshold:
            self.left_out.append(f"{one.describe()} has no score")
        else:
            self.good.append(one)

    @property
    def good_on_new_gel(self) -> list[ConfirmedPress]:
        """Those of the new gel that people call good."""
        return [judged for judged in self.good if judged.press.press_id in self.on_new_gel]

    def leave_out_far(self) -> None:
        """Leave out good ones that lie far beyond the threshold, or on a new gel beyond the others."""
        here = [judged.ratio for judged in self.good_on_new_gel]
        usual = max(1.0, float(np.median(here))) if here else 1.0
        kept = list[ConfirmedPress]()
        for judged in self.good:
            farthest = FARTHEST * (usual if judged.press.press_id in self.on_new_gel else 1)
            if judged.ratio <= farthest:
                kept.append(judged)
                continue
            if judged.press.press_id in self.doubted:  # whether the new bundle passes it is said all the same
                self.others.append(judged.press)
            self.left_out.append(
                f"{judged.describe()} lies beyond {farthest:.3g} times the threshold; if such parts are good, give a "
                "picture of it among the nominal presses"
            )
        self.good = kept

    def check_new_gel(self) -> None:
        """Errors: FitError where too little is known of the gel on which the bundle is not proven, or the gel is too
        different."""
        here = self.good_on_new_gel
        if self.new_gel is None:
            return
        if len(here) < LEAST_ON_NEW_GEL:
            raise FitError(
                f"the bundle is not proven on gel {self.new_gel.gel_id}, and people call {len(here)} of its presses "
                f"good, at least {LEAST_ON_NEW_GEL} are needed; answer the station's questions about it"
            )
        usual = float(np.median([press.ratio for press in here]))
        if usual > MOST_CHANGE:
            raise FitError(
                f"good presses on gel {self.new_gel.gel_id} score {usual:.2f} times the threshold in the median, "
                f"expected at most {MOST_CHANGE:g} times: another part, or too different a gel; fit a bundle on it"
            )


def score_refused(scorer: Scorer, press: ArchivedPress, frame: bytes) -> float | None:
    """Score a press that this bundle refused for its colours; None for other presses, for another kind of sensor, and
    for what cannot be scored."""
    bundle = scorer.bundle
    colours = bundle.manifest.colours
    if colours is None or not (press.reason or "").startswith(f"{Reason.OTHER_SENSOR}:"):
        return None
    rgb = np.ascontiguousarray(
        bundle.region.crop(decode(CameraFrame(frame, 0, 0, is_on_demand=True), bundle.profile))
    )
    lit = rgb
    if press.light is not None:
        lit = FollowedLight(*press.light).restore(rgb, bundle.region, bundle.profile.size)
    nominal = colours.nominal()
    if is_other_kind(colour_cells(lit, nominal.cells.shape[:2]), nominal):
        return None
    try:
        return scorer.score(lit).anomaly_score
    except (PoseNotFound, NotScorable):
        return None


def read_confirmed(
    database: Path,
    part: PartPosition,
    bundle_id: str,
    score_anyway: Callable[[ArchivedPress, bytes], float | None] = lambda press, frame: None,
) -> ConfirmedPresses:
    """Read them with their frames. bundle_id: of the bundle that learns. score_anyway: scores presses of a new gel that
    it refused. Errors: StoreError."""
    presses, archive = ConfirmedPresses(), ArchiveFolder(database.with_suffix(".archive"))
    with open_read_only(database, "reading what people said") as connection:
        verdicts = read_verdicts(connection)
        rows = connection.execute(
            "SELECT press_id, evidence, second_of, piece_id, serial, gel_id FROM presses "
            "WHERE part = ? AND position = ? ORDER BY number",
            part,
        ).fetchall()
        presses.new_gel = unproven_gel(connection, bundle_id)
    if presses.new_gel is not None:
        presses.on_new_gel = {row[0] for row in rows if row[4:] == presses.new_gel[:2]}
    pieces = dict[str, str]()
    for press_id, _, first, piece_id, *_ in rows:
        pieces[press_id] = piece_id or pieces.get(first, first or press_id)
    for press_id, evidence, *_ in reversed(rows):
        verdict = settle(verdicts.get(press_id, ()))
        is_doubted = any(word.saying == "damaged" for word in verdicts.get(press_id, ()))
        if verdict is not None:
            presses.words[verdict.saying] += 1
        if is_doubted:
            presses.doubted.add(press_id)
        if not is_doubted and (verdict is None or verdict.saying not in ("good", "damaged")):
            with suppress(ArchiveError):  # the archive keeps the newest ones
                if evidence is not None and (verdict is not None or len(presses.others) < MOST_OTHERS):
                    presses.others.append(archive.press(press_id, evidence))
            continue
        assert verdict is not None
        try:
            press = archive.press(press_id, evidence)
            frame = archive.read(press.frame, f"the judged frame of press {press_id}")
            unjudged = None if press.masked is None else archive.read_masked(press)
            archive.read_reference(press)  # without it the press cannot be judged again
        except ArchiveError as error:
            unknown = "; whether the new bundle finds this damage is not known" if is_doubted else ""
            presses.left_out.append(f"{error}{unknown}")
            continue
        is_here = press_id in presses.on_new_gel and verdict.saying == "good"
        score = score_anyway(press, frame) if is_here else None
        presses.add(ConfirmedPress(press, verdict, frame, pieces[press_id], unjudged, score))
    presses.leave_out_far()
    return presses


def write_pictures(presses: Sequence[ConfirmedPress], folder: Path) -> list[Path]:
    """Write them as pictures with the names of their presses, and return these, sorted."""
    folder.mkdir()
    return sorted(write_picture(confirmed.press, confirmed.frame, folder) for confirmed in presses)


def join_pieces(presses: NominalPresses, confirmed: Sequence[ConfirmedPress]) -> NominalPresses:
    """Return the presses; those of the station that are of one piece, by its count, have one. presses: read from what
    `write_pictures` has written, and others."""
    names = [Path(name).stem for name in presses.names]
    specimens = list(presses.specimens)
    for piece in {press.piece for press in confirmed}:
        ids = {press.press.press_id for press in confirmed if press.piece == piece}
        rows = [k for k, name in enumerate(names) if name in ids]
        known = [specimens[k] for k in rows if specimens[k] is not None]
        for k in rows if len(rows) > 1 else ():
            specimens[k] = known[0] if known else presses.names[rows[0]]
    return replace(presses, specimens=tuple(specimens))


def leave_out_places(presses: NominalPresses, unjudged: Mapping[str, Mask | None]) -> NominalPresses:
    """Return the presses; those of the station with the places at which it did not judge them, of the region of now.
    presses: as `join_pieces` takes them. unjudged: by the id of the press."""
    nothing = np.zeros(presses.frames.shape[1:3], np.bool_)
    places = {
        press_id: mask
        for press_id, mask in unjudged.items()
        if mask is not None and mask.shape == nothing.shape
    }
    masks = [places.get(Path(name).stem, nothing) for name in presses.names]
    return replace(presses, unjudged=np.stack(masks)) if places else presses


def write_picture(press: ArchivedPress, frame: bytes, folder: Path) -> Path:
    """Write the camera's bytes as a picture with the name of its press, and return its path. Where the light was
    followed, it is the picture under the light of the fit: nominal presses are of that light."""
    ending = "png" if kind(frame) == "png" else "jpg"
    if press.light is not None:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        bgr = np.asarray(cv2.imdecode(np.frombuffer(frame, np.uint8), flags), np.uint8)
        lit = FollowedLight(*press.light).restore(np.ascontiguousarray(bgr[..., ::-1]))
        frame, ending = cv2.imencode(".png", np.ascontiguousarray(lit[..., ::-1]))[1].tobytes(), "png"
    path = folder / f"{press.press_id}.{ending}"
    path.write_bytes(frame)
    return path


@dataclass(frozen=True)
class Comparison:
    """How two bundles judge the presses that people spoke of."""

    presses: ConfirmedPresses
    before: Mapping[str, Press]
    """By the id of the press, judged by the old bundle."""
    after: Mapping[str, Press]

    def count(self, presses: Sequence[ConfirmedPress], judged: Mapping[str, Press]) -> int:
        """Count those that do not pass."""
        return sum(judged[press.press.press_id].word != "pass" for press in presses)

    def describe(self) -> str:
        """Give both in one sentence."""
        damaged, good = self.presses.damaged, self.presses.good
        return (
            f"of {len(damaged)} presses that people call damaged {self.count(damaged, self.before)} do not pass the "
            f"old bundle and {self.count(damaged, self.after)} do not pass the new one; of {len(good)} that they call "
            f"good {self.count(good, self.before)} and {self.count(good, self.after)}"
        )

    def changes(self) -> str:
        """Say which of the other presses get another verdict, first those that pass now."""
        others = [one.press_id for one in self.presses.others]
        known = self.before.keys() & self.after.keys()
        both = [(key, self.before[key].word, self.after[key].word) for key in others if key in known]
        both.sort(key=lambda one: one[2] != "pass")
        changed = [f"{key} {before} to {after}" for key, before, after in both if before != after]
        named = "; ".join(changed[:MOST_NAMED]) + (" and others" if len(changed) > MOST_NAMED else "")
        sentence = f"{len(changed)} of {len(both)} other archived presses change" + (
            f": {named}" if changed else ""
        )
        passing = [key for key in sorted(self.presses.doubted & known) if self.after[key].word == "pass"]
        return sentence + (
            f"; it passes {', '.join(passing)}, which somebody called damaged" if passing else ""
        )

    @property
    def lost(self) -> list[ConfirmedPress]:
        """The damage that was found before and that the new bundle passes."""
        return [
            one
            for one in self.presses.damaged
            if (self.before[one.press.press_id].word != "pass" or one.press.verdict == "fail")
            and self.after[one.press.press_id].word == "pass"
        ]

    @property
    def new_alarms(self) -> list[ConfirmedPress]:
        """The good presses that the new bundle alone fails, where it fails more of them. On a gel on which the old
        bundle is not proven those of this gel count, as for a takeover: what another gel shows comes no more."""
        good = self.presses.good if self.presses.new_gel is None else self.presses.good_on_new_gel
        if self.count(good, self.after) <= self.count(good, self.before):
            return []
        words = [(self.before[one.press.press_id].word, self.after[one.press.press_id].word) for one in good]
        return [one for one, (then, now) in zip(good, words, strict=True) if then == "pass" != now]

    @property
    def is_quieter(self) -> bool:
        """Tell whether the new bundle passes clearly more of the presses that nobody called damaged."""
        sound = {one.press.press_id for one in self.presses.good}
        sound |= {one.press_id for one in self.presses.others} - self.presses.doubted
        known = sound & self.before.keys() & self.after.keys()
        words = [(self.before[key].word, self.after[key].word) for key in known]
        gained, lost = (
            sum((one == "pass") < (other == "pass") for one, other in pairs)
            for pairs in (words, [pair[::-1] for pair in words])
        )
        return is_more(gained, lost)

    def check(self) -> None:
        """Errors: FitError where the new bundle loses a known damage, or fails more good parts."""
        if lost := [one.describe() for one in self.lost]:
            raise FitError(
                f"the new bundle passes what was found before, and is not written: {'; '.join(lost)}. Look at these "
                "presses: what was called good may be damaged too, or the other way round"
            )
        if alarms := [alarm.describe() for alarm in self.new_alarms[:MOST_NAMED]]:
            raise FitError(
                "the new bundle fails more of the presses that people call good, and is not written: "
                f"{self.describe()}; it alone fails {'; '.join(alarms)}"
            )


def judge_presses(
    bundle: Bundle, presses: ConfirmedPresses, database: Path, threads: int, report: Report
) -> dict[str, Press]:
    """Judge them again, by their ids, as a replay does. Errors: ArchiveError, BundleError."""
    archive, judged = ArchiveFolder(database.with_suffix(".archive")), dict[str, Press]()
    inspector = Inspector(Scorer(bundle, threads), SystemClock())
    kept = [one.press for one in (*presses.good, *presses.damaged)]
    every = [*kept, *presses.others]
    for k, press in enumerate(every):
        report("archived presses", k / len(every))
        # A running station removes the oldest of the others meanwhile.
        may_lack = () if k < len(kept) else (ArchiveError,)
        with suppress(*may_lack):
            judged[press.press_id] = judge_as_then(press, archive, inspector).drop_pictures()
    report("archived presses", 1.0)
    return judged
