"""Whether presses are registered: where a fixture or a hand holds the part, and where it finds more damage.

A part that is held lies further away one day than in all presses of its fit, and then looks damaged to a method that
compares places. For others the proof is made on the part's own presses: a third is held out, small damage is rendered
into those, and banks of the others judge them, registered and as they lie. Where presses lie so far apart that they are
not compared as they lie, what the fit sees of its damage anyway decides: as by chance is too little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calibration.fitting.damage.damaged_presses import SIZE_SHARES, DamagedPresses, render_damage
from calibration.fitting.limits.held_out import HeldOut, Learner, ShownPresses
from calibration.fitting.pose.completed import complete_places, completed
from calibration.fitting.pose.registration import LearntPose, keep_pose, learn_pose
from calibration.fitting.pose.two_parts import find_two_parts
from calibration.fitting.presses.augmentation import FEW, Take
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.strangers import list_names
from calibration.fitting.self_check import AT_CHANCE, may_compare
from calibration.metrics.summary import auroc
from edge.core.arrays import F64, U8, Mask
from edge.core.detector import Nominal
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.registration.colours import FreeLight
from edge.core.registration.pose import Registered, warp
from edge.core.registration.registrar import PartInPose, Registrar, find_relief
from edge.model.manifest_facts import UNPROVEN
from edge.model.tile_runner import most_typical

__all__ = ["PoseChoice", "Register", "choose_pose"]

Register = Literal["auto", "never", "always"]

SPREAD_MM = 0.25
"""Up to this median distance from their common pose a few presses, and those of a method that compares no places, are
compared as they lie: a fixture has less. A hand has more: at 0.4 mm PaDiM on `tactile_lite0` had an AU-PRO of 0.28 and
0.73 on two simulated parts as they lay, 0.79 and 0.90 registered."""

HELD_MM = 0.5
"""Up to this distance a fixture or a hand holds the part, and its presses are registered without a proof: the proof
knows no press that lies further away. The turn is the nearest, also where the part looks the same in several."""

LEAST_PRESSES = 6
"""With fewer presses nothing can be held out to prove that registration pays."""

_HELD_OUT = 3

_ENOUGH_TO_TURN = 24
"""So many presses turned a connector with three pins right in most draws, 12 in fewer. Of a part whose tilt hides what
breaks its symmetry, 40 told no more than 20."""

_NEARLY = 0.05
"""By so much two figures of a proof differ by chance, of some 14 sound presses. Then presses whose places are compared
are registered: of a part that a hand laid 0.5 mm off, 0.844 were separated registered and 0.855 as they lay, and of 21
further sound presses 0 and 3 failed."""

# The sizes of damage by which it is proven, the largest last.
_PROOF_SIZES = SIZE_SHARES[1:]

View = tuple[SensorProfile, Region]


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """How presses come to the bank."""

    learnt: LearntPose | None
    """None where presses are scored as they lie."""
    why: str = ""
    """A sentence for the operator, empty for nothing to say."""
    separated: float | None = None
    """Image AUROC of the largest rendered damage, as the presses are scored; None where it was not measured."""
    is_open: bool = False
    """Whether registration is to be proven by the presses that the fit holds out."""
    faults: tuple[str, ...] = ()
    """A sentence for presses of another part."""

    def prove(self, held_out: HeldOut | None, damage: DamagedPresses | None) -> "PoseChoice":
        """Return the choice with its proof by banks without the press; unregistered where they show nothing."""
        if held_out is None or damage is None:
            return PoseChoice(None, f"{self.why}, but no damage could be rendered", faults=self.faults)
        kinds = [name.split()[0] for name in damage.names]
        smallest = [damage.names[kinds.index(kind)] for kind in dict.fromkeys(kinds)]
        largest = list(dict(zip(kinds, damage.names, strict=True)).values())
        large = [k for k, name in enumerate(damage.names) if name in largest]
        some = [k for k, name in enumerate(damage.names) if name not in smallest]
        separation, found_large = (
            _separate(held_out.sound.scores, held_out.edited.scores[rows]) for rows in (some, large)
        )
        why = f"{self.why}; {_words(separation)} (image AUROC, out of fold)"
        if separation <= AT_CHANCE:
            return PoseChoice(None, f"{why}, as by chance", faults=self.faults)
        return replace(self, why=f"presses are registered: {why}", separated=found_large, is_open=False)

    @property
    def facts(self) -> dict[str, str]:
        """The sentence for the manifest."""
        return {"registration": self.why} if self.why else {}

    def find_warnings(self, names: Sequence[str], faults: Sequence[str] = ()) -> list[str]:
        """Name presses of another part, and those not recognised, and say that turns that are compared may be wrong.

        faults: what is said of these presses before, which may be the reason.
        """
        sentences = [*self.faults]
        if self.learnt is None:
            return sentences
        if lost := [names[k] for k in self.learnt.unrecognised]:
            first = "mend first what is said before of presses; else " if faults else ""
            sentences.append(
                f"the part is not recognised in {list_names(lost, len(names))}: a gateway rejects such presses; "
                f"{first}press nearer to the middle, and leave these out (--leave-out '{lost[0]}')"
            )
        part, count = self.learnt.part, len(names)
        if part.is_held:
            return sentences
        if part.nearly == part.symmetry > 1:
            more = f", or press at least {_ENOUGH_TO_TURN}" * (count < _ENOUGH_TO_TURN)
            return [
                f"{UNPROVEN}the part nearly looks the same {part.nearly} times in a full turn, and none of {count} "
                "presses tells at which of these turns it lies: damage that differs less than they do passes; hold the "
                f"part at one turn{more}, and fit again",
                *sentences,
            ]
        unsure = [names[k] for k in self.learnt.unsure]
        if part.nearly and not unsure:
            return sentences
        some = f"{list_names(unsure, count)} agree" if unsure else "some agree"
        steps = f"by {360 / part.nearly:.0f} degrees" if part.nearly > 1 else "by other angles"
        return [
            *sentences,
            f"the turn of presses is not sure: {some} nearly as well turned {steps}; where one is turned wrong, "
            "what breaks the symmetry scores high or hides damage; hold the part at one turn",
        ]

    def apply(self, presses: NominalPresses) -> NominalPresses:
        """Bring the presses to the pose of the bank; registered ones lie at one place, their touch is unknown. Places
        that a station did not judge, as under scars of its gel, are those of other presses."""
        if self.learnt is None:
            hidden = presses.unjudged
            shown = presses.frames if hidden is None else complete_places(list(presses.frames), list(~hidden))
            return replace(presses, frames=shown)
        touches = tuple(replace(touch, x=0.5, y=0.5) for touch in presses.touches)
        return replace(
            presses, frames=self.learnt.frames, raw=None, touches=touches, touched=None, unjudged=None
        )

    def show(self, nominal: Nominal, take: Take, presses: NominalPresses) -> ShownPresses:
        """Return the nominal presses as the gateway shows them to the bank: what a press does not show is the mean
        press, and does not count. What the bank learns there is other presses, with seams that no gateway makes.
        nominal: what is learnt of them. presses: as they lie."""
        if self.learnt is None:
            hidden = presses.unjudged
            features = nominal.features if hidden is None else take(presses.frames)
            return ShownPresses(features, unjudged=hidden)
        registered = self.learnt.registered
        return ShownPresses(take(np.stack([placed.rgb for placed in registered])), registered)

    def take_shown(self, take: Take) -> Take:
        """Return what takes the features of presses as the gateway brings them to the bank."""
        if self.learnt is None:
            return take
        registrar = Registrar(self.learnt.part)
        return lambda frames: take(np.stack([registrar.register(rgb).rgb for rgb in frames]))

    def show_damage(
        self, damage: DamagedPresses, take: Take, unjudged: Mask | None = None
    ) -> tuple[DamagedPresses, ShownPresses]:
        """Bring presses with damage to the bank as the gateway does; those without a pose are left out. unjudged: of
        the nominal presses."""
        hidden = None if unjudged is None else unjudged[damage.press]
        if self.learnt is None:
            return damage, ShownPresses(take(damage.frames), unjudged=hidden)
        registrar = Registrar(self.learnt.part)
        registrations = [registrar.register(rgb) for rgb in damage.frames]
        if hidden is not None:
            registrations = list(map(Registered.without, registrations, hidden))
        kept = [k for k, registration in enumerate(registrations) if registration.refusal is None] or list(
            range(len(registrations))
        )
        moved = [
            (warp(damage.masks[k].astype(np.float32), registrations[k].pose) > 0.5) & registrations[k].seen
            for k in kept
        ]
        posed = replace(damage.choose(kept), masks=np.stack(moved))
        return posed, ShownPresses(
            take(np.stack([registrations[k].rgb for k in kept])), [registrations[k] for k in kept]
        )


def choose_pose(
    register: Register,
    presses: NominalPresses,
    learner: Learner,
    take: Take,
    view: View,
    is_held_out: bool = False,
    earlier: PartInPose | None = None,
) -> PoseChoice:
    """Decide whether presses are registered. take: the features of frames. earlier: a pose that they are brought to.

    is_held_out: whether presses that are not compared as they lie may be proven by those that the fit holds out.
    Errors: FitError where registration is asked for and cannot be had.
    """
    if earlier is not None:
        return PoseChoice(
            keep_pose(earlier, presses.frames, presses.unjudged),
            "presses are registered as in the bundle before",
        )
    if register == "never":
        return PoseChoice(None)
    try:
        learnt = _learn(presses)
    except FitError as error:
        if register == "always":
            raise
        return PoseChoice(None, f"presses are compared as they lie: {error}")
    spread = pose_spread_mm(learnt, view[0].pixels_per_mm)
    faults = tuple(find_two_parts(learnt, presses.names))
    lie = f"in the median presses lie {spread:.2f} mm from their common pose"
    apart = f"{lie}{_doubt(learnt.part)}"
    if register == "always":
        return PoseChoice(learnt, f"presses are registered, as asked for; {apart}", faults=faults)
    has_copies = len(presses) <= FEW  # they are moved, so the bank knows what lies further away
    if spread <= HELD_MM and learner.detector.compares_places and not has_copies:
        held = replace(learnt.part, is_held=True, symmetry=min(1, learnt.part.symmetry), nearly=1)
        why = f"presses are registered: {lie}, and the next may lie further away"
        return PoseChoice(keep_pose(held, presses.frames, presses.unjudged), why, faults=faults)
    if spread <= SPREAD_MM:
        why = f"presses are compared as they lie: {apart}, {SPREAD_MM} mm are tolerated"
        return PoseChoice(None, why, faults=faults)
    if not (learnt.part.is_turning or learner.detector.compares_places):
        why = f"presses are compared as they lie: {apart}, and {learner.detector.name} compares no places"
        return PoseChoice(None, why, faults=faults)
    choice = PoseChoice(learnt, apart, faults=faults)
    if is_held_out and not may_compare(presses, view[0], learner.detector):
        return replace(choice, why=f"{apart}, too far to be compared as they lie", is_open=True)
    return _compare_poses(choice, presses, learner, take, view)


def _compare_poses(
    choice: PoseChoice, presses: NominalPresses, learner: Learner, take: Take, view: View
) -> PoseChoice:
    """Register presses where that separates more of the damage, or nearly as much. choice: and how far they lie."""
    learnt, apart = choice.learnt, choice.why
    proof = None if learnt is None else _Proof.of(presses, learnt, learner, take, view)
    if proof is None:
        why = f"presses are compared as they lie: {apart}, but no damage could be rendered"
        return PoseChoice(None, why, faults=choice.faults)
    (registered, large), (still, large_still) = proof.judge_registered(), proof.judge_still()
    both = f"{_words(registered)}, {still:.3f} without"
    if registered > still - _NEARLY * learner.detector.compares_places:
        further = "" if registered > still else ", which is nearly as much, and the next may lie further away"
        why = f"presses are registered: {apart}; {both} (image AUROC, out of fold){further}"
        return replace(choice, why=why, separated=large)
    why = f"presses are compared as they lie: {apart}, but {both}"
    return PoseChoice(None, why, large_still, faults=choice.faults)


def _words(separated: float) -> str:
    return f"of rendered damage {separated:.3f} is separated from sound presses with it"


def _doubt(part: PartInPose) -> str:
    """Say that a part which repeats itself has no turn of its own; empty for other parts."""
    if part.symmetry == 1:
        return ""
    if not part.is_turning:
        return ", a round part without a turn"
    looks = "nearly looks" if part.nearly == part.symmetry else "looks"
    return (
        f"; the part {looks} the same {part.symmetry} times in a full turn: it is compared as if turned by the least "
        "of these, and what breaks the symmetry in sound parts hides damage there; where it does not look so, hold it "
        "at one turn"
    )


def _learn(presses: NominalPresses) -> LearntPose:
    if presses.no_contact is None:
        raise FitError(
            "registration needs a picture of the free gel; give one with --no-contact, or a recording that shows it"
        )
    if len(presses) < LEAST_PRESSES:
        raise FitError(f"registration needs at least {LEAST_PRESSES} presses, found {len(presses)}")
    return learn_pose(presses.frames, most_typical(presses.no_contact), presses.unjudged)


def pose_spread_mm(learnt: LearntPose, pixels_per_mm: float) -> float:
    """The median over presses of how far the part's places lie from where they lie in the median press, in mm."""
    part = learnt.part
    slopes = part.colours.slopes(FreeLight(part.free).find_change(part.template))
    places = np.argwhere(part.learnt & find_relief(slopes))[::97, ::-1].astype(np.float64)
    size = part.learnt.shape[1], part.learnt.shape[0]
    matrices = [placed.pose.matrix(size) for placed in learnt.registered]
    moved = np.stack([places @ m[:, :2].T + m[:, 2] for m in matrices])
    away = np.linalg.norm(moved - np.median(moved, axis=0), axis=2).mean(axis=1)
    return float(np.median(away)) / pixels_per_mm


@dataclass(frozen=True, eq=False)
class _Proof:
    """Presses that are held out, and the same with damage, to be judged by banks of the others."""

    presses: NominalPresses
    learnt: LearntPose
    learner: Learner
    take: Take
    held: Sequence[int]
    damaged: U8
    """Of all sizes but the smallest, which few banks find, each after the next smaller one, uint8 (m, h, w, 3). The
    largest alone would be found with and without registration, and decide nothing."""

    @classmethod
    def of(
        cls, presses: NominalPresses, learnt: LearntPose, learner: Learner, take: Take, view: View
    ) -> "_Proof | None":
        """Hold a third out; None where no damage can be rendered."""
        held = list(range(0, len(presses), _HELD_OUT))
        edited = render_damage(presses.choose(held), *view, np.random.default_rng(learner.seed), _PROOF_SIZES)
        if edited is None:
            return None
        sizes = range(len(_PROOF_SIZES))
        damaged = np.concatenate([edited.frames[size :: len(sizes)] for size in sizes])
        return cls(presses, learnt, learner, take, held, damaged)

    @property
    def kept(self) -> list[int]:
        """The presses that banks are learnt from."""
        return [k for k in range(len(self.presses)) if k not in self.held]

    def judge_registered(self) -> tuple[float, float]:
        """Measure the image AUROC of the damage in registered presses: of all, and of the largest."""
        registered, registrar = self.learnt.registered, Registrar(self.learnt.part)
        sound = np.stack([registered[k].rgb for k in self.held])
        damaged = np.stack([registrar.register(rgb).rgb for rgb in self.damaged])
        return _auroc(self.learner, self.take, completed([registered[k] for k in self.kept]), sound, damaged)

    def judge_still(self) -> tuple[float, float]:
        """Measure the same as they lie."""
        frames = self.presses.frames
        return _auroc(self.learner, self.take, frames[self.kept], frames[self.held], self.damaged)


def _auroc(learner: Learner, take: Take, nominal: U8, sound: U8, damaged: U8) -> tuple[float, float]:
    """Measure how well the scores of damaged presses are told from those of sound ones: of all, and of the largest."""
    features = take(np.concatenate([nominal, sound, damaged]))
    first = len(nominal)
    bank = learner.bank(Nominal({tap: maps[:first] for tap, maps in features.items()}))
    scores = learner.score(bank, features, range(first, first + len(sound) + len(damaged))).scores
    largest = len(damaged) // len(_PROOF_SIZES)
    sound_scores, damaged_scores = np.split(scores, [len(sound)])
    return _separate(sound_scores, damaged_scores), _separate(sound_scores, damaged_scores[-largest:])


def _separate(sound: F64, damaged: F64) -> float:
    """Measure the AUROC of scores; 0 where there are none."""
    return auroc(np.concatenate([sound, damaged]), np.arange(len(sound) + len(damaged)) >= len(sound)) or 0.0
