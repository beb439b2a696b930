"""Where on the gel the limit is higher, because sound presses score high there wherever their part lies.

A part that lies anywhere brings other places to a cut with each press, so no range by place of the part knows it, and
the cut sets the limit of all places. At the rim of the view the end of what a press shows raises its map. With m_i the
raw score map of press i where it lay, and usual 1.25 times the lower quartile of the presses' scores:

    highest, second = largest and second largest m_i within 0.6 mm of a place, over the presses i
    limits          = 1.5 min(highest, 2 second) / usual where highest is above usual, second above 0.75 usual

and in the last millimetre of the view at least 1.4 rim / usual, where the second largest of the presses' highest
m_i / limits there, rim, is above 0.85 usual. A score map is divided by `limits`. One press, of dust or of damage,
raises no limit by itself, and where others score high too at most to twice what they show. Of many presses a few lie
high anywhere by chance, so of each 40 one more is passed over. A press is judged by the limits of the other folds, a
new one by those of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calibration.fitting.limits.appended import find_obstacle
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses, ShownPresses
from calibration.fitting.limits.limit_choice import WORTH, Choice, Evidence, choose_limit
from calibration.fitting.limits.map_limit import PLAIN
from edge.core.arrays import F32, F64
from edge.core.registration.pose import GEL_LIMIT_STEPS, Registered, gel_limits_in_pose, warp
from edge.core.registration.registrar import PartInPose

__all__ = ["LimitsChosen", "choose_limits", "learn_gel_limits"]

# Chosen on three real balls of the development sensors, one gel with cuts and one without, and a simulated edge, each
# divided anew into learnt and held-out presses. A cell of the deepest tap is a millimetre: as far the end of the view
# shows. Two presses as high as `usual` were too much to ask for: of 16 presses few touch a cut, and a fold has fewer.
_NEAR_MM, _ABOVE, _QUARTILE, _USUAL = 0.6, 1.5, 0.25, 1.25
_SHOWN, _BEYOND_SECOND = 0.75, 2.0
_RIM_MM, _SHOWN_AT_RIM, _AT_RIM = 1.0, 0.85, 1.4
_PRESSES_EACH = 40


def find_near(maps: F32, pixels_per_mm: float, reach_mm: float = _NEAR_MM) -> F32:
    """Find the highest value near each place, of each of these maps."""
    reach = 2 * round(reach_mm * pixels_per_mm) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    return np.stack([cv2.dilate(score_map, kernel) for score_map in maps])


def learn_gel_limits(maps: F32, pixels_per_mm: float, presses: int, near: F32 | None = None) -> F32:
    """Learn the limits, float32 (h, w), from raw maps of nominal presses as they lie, (n, h, w), 0 where unseen.

    near: of the same by `find_near`, where it is known. presses: how many the fit has. Without some of them as many are
    passed over as with all, else these limits would be higher than the bundle's, and a press judged by them would look
    more usual than the next one will.
    """
    usual = _USUAL * float(np.quantile(maps.max(axis=(1, 2)), _QUARTILE))
    passed_over = 1 + presses // _PRESSES_EACH
    limits = np.ones(maps.shape[1:], np.float32)
    if not usual > 0 or len(maps) <= passed_over:
        return limits
    near = find_near(maps, pixels_per_mm) if near is None else near
    first = len(near) - 1 - passed_over
    second, highest = np.partition(near, (first, first + 1), axis=0)[first : first + 2]
    high = np.minimum(highest, _BEYOND_SECOND * second)
    np.copyto(limits, _ABOVE * high / usual, where=(second > _SHOWN * usual) & (highest > usual))
    rim, margin = np.ones(limits.shape, np.bool_), round(_RIM_MM * pixels_per_mm)
    rim[margin:-margin, margin:-margin] = False
    at_rim = np.sort((maps[:, rim] / limits[rim]).max(axis=1))[-1 - passed_over]
    if at_rim > _SHOWN_AT_RIM * usual:
        limits[rim] = np.maximum(limits[rim], _AT_RIM * at_rim / usual)
    # As they are stored.
    return np.asarray(np.minimum(np.ceil(limits * GEL_LIMIT_STEPS), 255) / GEL_LIMIT_STEPS, np.float32)


@dataclass(frozen=True, eq=False)
class LimitsChosen:
    """The kind of limit, and where on the gel it is higher."""

    choice: Choice
    evidence: Evidence
    """With the limits of the gel in its scores."""
    gel_limits: F32 | None = None
    """As `PartInPose.gel_limits`."""

    def extend(self, part: PartInPose | None) -> PartInPose | None:
        """Return the part with the limits of the gel; None where presses are scored as they lie."""
        return part and replace(part, gel_limits=self.gel_limits)

    @property
    def highest_limit(self) -> float:
        """By how much a score is divided at most; the map of missing relief is multiplied by it, and hides nowhere."""
        return 1.0 if self.gel_limits is None else float(self.gel_limits.max())

    @property
    def scores(self) -> F64:
        """Scores of the nominal presses, in units of the bundle's score, (n,)."""
        return self.choice.other.scores if self.choice.other else self.evidence.scores

    @property
    def share_found(self) -> float:
        """The share of the rendered damage that is found."""
        return self.choice.found.get(self.choice.kind, 0.0)


def choose_limits(
    evidence: Evidence, shown: ShownPresses, damaged: ShownPresses, head: bytes
) -> LimitsChosen:
    """Choose the kind of limit, with limits of the gel if clearly more damage is found with them.

    shown: the nominal presses. damaged: those with damage. head: the graph that the limit is to be appended to.
    """
    if obstacle := find_obstacle(head):
        why = f"another limit cannot be appended to the method's graph: {obstacle}"
        return LimitsChosen(Choice(PLAIN, why), evidence)
    usual = LimitsChosen(choose_limit(evidence), evidence)
    if shown.registered is None or damaged.registered is None or not evidence.is_score_a_maximum:
        return usual
    lying = np.stack(
        [
            warp(np.where(one.seen, found, 0).astype(np.float32), one.pose.inverse())
            for one, found in zip(shown.registered, evidence.held_out.sound.maps, strict=True)
        ]
    )
    near = find_near(lying, evidence.pixels_per_mm)
    limits = learn_gel_limits(lying, evidence.pixels_per_mm, len(lying), near)
    if not (limits > 1).any():
        return usual
    weighed = _weigh_all(evidence, lying, near, limits, shown.registered, damaged.registered)
    chosen = LimitsChosen(choose_limit(weighed), weighed, limits)
    if chosen.share_found < usual.share_found + WORTH:
        return usual
    why = (
        f"{chosen.choice.why}; at {np.mean(limits > 1):.0%} of the gel the limit is up to {limits.max():.1f} times as "
        "high, because several sound presses score high there wherever the part lies, as at a cut or at the rim of the "
        f"view; without that {usual.share_found:.0%} are found"
    )
    return replace(chosen, choice=replace(chosen.choice, why=why))


def _weigh_all(
    evidence: Evidence,
    lying: F32,
    near: F32,
    limits: F32,
    poses: Sequence[Registered],
    damaged: Sequence[Registered],
) -> Evidence:
    """Weigh each press by what the other folds show of the gel; by all where the bank knows it too.

    lying, near: as `learn_gel_limits` takes them.
    """
    fold_of = np.zeros(len(lying), np.int64)
    for number, held in enumerate(evidence.folds):
        fold_of[held] = number
    mm = evidence.pixels_per_mm
    apart = [
        learn_gel_limits(np.delete(lying, held, 0), mm, len(lying), np.delete(near, held, 0))
        for held in evidence.folds
    ]
    sound, edited = evidence.held_out.sound, evidence.held_out.edited
    held_out = HeldOut(
        _weigh(sound, [apart[k] for k in fold_of], poses),
        _weigh(edited, [apart[k] for k in fold_of[evidence.damage.press]], damaged),
    )
    return replace(evidence, held_out=held_out, known=_weigh(evidence.known, [limits] * len(lying), poses))


def _weigh(scored: ScoredPresses, limits: Sequence[F32], poses: Sequence[Registered]) -> ScoredPresses:
    """Divide what counts of the presses by the limits of each, which are of the gel."""
    weights = [
        gel_limits_in_pose(limit, registered.pose) for limit, registered in zip(limits, poses, strict=True)
    ]
    weighed = replace(scored, gel_limits=np.stack(weights))
    return replace(weighed, scores=weighed.highest(scored.maps))
