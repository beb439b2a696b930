"""Which limit a bundle has: that by which banks without them find most of the damage rendered into nominal presses.

Every kind of limit gets the same chance of a false alarm: it is the conformal threshold of the nominal presses'
out-of-fold scores. No label is used. A kind has to find clearly more than the plain limit.

Where a limit learns from the presses at each place, a press is compared with what the other folds show there: a press
that takes part in its own range looks more usual than the next one will.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damaged_presses import DamagedPresses, render_damage
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.head_limit import can_extend
from calibration.fitting.limits.held_out import HeldOut, Learner, ScoredPresses, score_held_out
from calibration.fitting.limits.map_limit import KINDS, PLAIN, LimitKind, MapLimit, Spread, learn_spread
from calibration.fitting.limits.threshold import conformal_threshold, pieces_of
from calibration.fitting.presses.augmentation import Take
from calibration.fitting.presses.colours import nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.scatter import SCATTERED_MM, scatter_mm
from edge.core.detector import Bank, Features, Nominal, Progress
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.press_again import KnownScores
from edge.model.manifest import ThresholdEntry
from edge.model.press_again_facts import PRESS_AGAIN, score_facts

__all__ = ["WORTH", "Choice", "Evidence", "LimitTrial", "OtherLimit", "choose_limit", "prepare_trial"]

Float = NDArray[np.float64]

WORTH = 0.05
"""A kind of limit has to find this share of the rendered damage more than the plain limit."""

# Where the largest value of a map is not the press's score to this share, the score is something else.
_SAME = 1e-4

# Score maps of all presses are kept until a limit is chosen; of more than this only the scores are.
MEMORY_BYTES = 1 << 30


@dataclass(frozen=True, eq=False)
class OtherLimit:
    """A limit other than the plain one."""

    limit: MapLimit
    threshold: ThresholdEntry
    """At 1."""
    scores: Float
    """Scores of the nominal presses in units of the limit, (n,)."""
    damaged: Float
    """Scores of the presses with rendered damage, (m,)."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The kind of limit that a bundle has, and why."""

    kind: LimitKind
    why: str
    other: OtherLimit | None = None
    """None for the plain limit."""
    found: Mapping[str, float] = field(default_factory=dict)
    """The share of the rendered damage that each kind finds, by its name; empty where nothing was compared."""

    def facts(self) -> dict[str, Any]:
        """Return the choice for the manifest."""
        shares = {name: round(share, 4) for name, share in self.found.items()}
        return {"kind": self.kind.name, "why": self.why, "found": shares}


@dataclass(frozen=True, eq=False)
class LimitTrial:
    """How a limit is chosen: presses are scored out of fold, with and without rendered damage."""

    learner: Learner
    take: Take
    folds: Folds
    alpha: float
    specimens: Sequence[str | None]
    kinds: Sequence[LimitKind]
    is_black_refused: bool
    """Whether the gateway refuses a black frame for its colours."""
    why_plain: str
    """Why the plain limit is used without a choice; empty for a choice."""
    damage: DamagedPresses | None
    """Presses with rendered damage; None where nothing is chosen by it."""
    features: Features | None
    """Features of the presses with damage."""

    def score(self, nominal: Nominal, progress: Progress = lambda fraction: None) -> HeldOut:
        """Score each press, also with damage, by a bank without it. Errors: FitError."""
        edited = None if self.features is None or self.damage is None else (self.features, self.damage.press)
        return score_held_out(self.learner, nominal, self.folds, edited, progress)

    def choose(self, held_out: HeldOut, bank: Bank, nominal: Nominal) -> Choice:
        """Choose the limit for the final bank. Errors: FitError."""
        if self.damage is None:
            return Choice(PLAIN, self.why_plain)
        if not can_extend(self.learner.head(bank)):
            return Choice(PLAIN, "another limit cannot be appended to the method's graph")
        evidence = Evidence(
            held_out,
            self.learner.score(bank, nominal.features, range(nominal.presses)),
            self._score_black(bank),
            self.damage,
            self.folds,
            self.specimens,
            self.alpha,
            self.learner.grid.pixels_per_mm,
        )
        return choose_limit(evidence, self.kinds)

    def _score_black(self, bank: Bank) -> ScoredPresses | None:
        """Score a black frame; None where the gateway refuses it for its colours."""
        black = np.zeros((1, *self.learner.grid.frame, 3), np.uint8)
        return None if self.is_black_refused else self.learner.score(bank, self.take(black), [0])

    def count_found(self, held_out: HeldOut, choice: Choice, threshold: float) -> tuple[int, int] | None:
        """Count the presses with rendered damage that are found, and all of them; None where none was rendered.

        threshold: the score that a press fails above, where the choice has not counted them.
        """
        if self.damage is None:
            return None
        above = float((held_out.edited.scores > threshold).mean())
        share = choice.found.get(choice.kind.name, above)
        return round(share * len(self.damage)), len(self.damage)

    def press_again_facts(self, held_out: HeldOut, choice: Choice, scores: Float) -> dict[str, Any]:
        """Return what a station needs to know whether one more press pays; empty without rendered damage.

        scores: of the nominal presses, in units of the bundle's score.
        """
        if self.damage is None:
            return {}
        damaged = choice.other.damaged if choice.other else held_out.edited.scores
        names = tuple(dict.fromkeys(self.damage.names))
        of = np.array([names.index(name) for name in self.damage.names])
        groups = tuple(tuple(damaged[of == k].tolist()) for k in range(len(names)))
        keys = np.array(pieces_of(self.specimens))
        sound = tuple(tuple(scores[keys == piece].tolist()) for piece in dict.fromkeys(keys.tolist()))
        return {PRESS_AGAIN: score_facts(KnownScores(sound, groups), names)}


def prepare_trial(
    learner: Learner,
    presses: NominalPresses,
    view: tuple[SensorProfile, Region],
    take: Take,
    folds: Folds,
    alpha: float,
    why_plain: str = "",
) -> LimitTrial:
    """Render damage into the presses, unless the plain limit is used anyway."""
    if not why_plain and 4 * int(np.prod(presses.frames.shape[:3])) > MEMORY_BYTES:
        why_plain = f"the score maps of {len(presses)} presses take more memory than a choice may use"
    damage = None
    if not why_plain:
        damage = render_damage(presses, *view, np.random.default_rng(learner.seed))
        if damage is None:
            why_plain = "there is no picture of the free gel, or no contact, to render damage with"
    # Where presses lie anywhere the next one lies where none was, and no range is known there.
    scatter = scatter_mm(presses, view[0])
    is_placed = scatter is not None and scatter <= SCATTERED_MM
    return LimitTrial(
        learner,
        take,
        folds,
        alpha,
        presses.specimens,
        [kind for kind in KINDS if is_placed or not kind.is_by_place],
        refuses(nominal_colours(presses.frames), np.zeros_like(presses.frames[0])),
        why_plain,
        damage,
        None if damage is None else take(damage.frames),
    )


@dataclass(frozen=True, eq=False)
class Evidence:
    """The raw maps and scores from which a limit is chosen."""

    held_out: HeldOut
    known: ScoredPresses
    """Of the nominal presses by the final bank, which knows them."""
    black: ScoredPresses | None
    """Of a black frame by it, which must not pass; None where the gateway refuses one for its colours."""
    damage: DamagedPresses
    folds: Folds
    specimens: Sequence[str | None]
    alpha: float
    pixels_per_mm: float

    @cached_property
    def plain(self) -> ThresholdEntry:
        scores = np.maximum(self.held_out.sound.scores, self.known.scores)
        return conformal_threshold(scores, self.alpha, specimens=self.specimens)

    @property
    def is_score_a_maximum(self) -> bool:
        sound = self.held_out.sound
        return bool(np.allclose(sound.maps.max(axis=(1, 2)), sound.scores, rtol=_SAME, atol=0))


class _Candidate:
    """One kind of limit, learnt from the evidence."""

    def __init__(self, kind: LimitKind, evidence: Evidence) -> None:
        self.kind, self.evidence = kind, evidence
        maps = evidence.held_out.sound.maps
        self.spread = self._learn(maps)
        scores = _highest(self.spread.standardise(evidence.known.maps))
        self.folds: list[tuple[NDArray[np.int64], Spread]] = []
        for held in evidence.folds:
            without = self._learn(np.delete(maps, held, axis=0)) if kind.is_by_place else self.spread
            self.folds.append((held, without))
            scores[held] = np.maximum(scores[held], _highest(without.standardise(maps[held])))
        self.threshold = conformal_threshold(scores, evidence.alpha, specimens=evidence.specimens)

    def _learn(self, maps: NDArray[np.float32]) -> Spread:
        return learn_spread(self.kind, maps, self.evidence.pixels_per_mm)

    def _relate(self, spread: Spread, maps: NDArray[np.float32]) -> Float:
        """Return maps in units of the limit that this spread gives."""
        return self._limit(spread).relate(maps)

    def _limit(self, spread: Spread) -> MapLimit:
        return spread.limit(self.threshold.value, self.evidence.plain.value)

    @property
    def is_usable(self) -> bool:
        """The limit is positive, and a black frame fails by it if it fails by the plain one."""
        plain, black = self.evidence.plain.value, self.evidence.black
        if not (self.threshold.value > 0 and plain > 0):
            return False
        if black is None or black.scores[0] <= plain:
            return True
        return bool(_highest(self._relate(self.spread, black.maps))[0] > 1)

    @cached_property
    def damaged(self) -> tuple[NDArray[np.bool_], Float]:
        """The damage that is found by the limit without its press, bool (m,), and the scores in units of that, (m,)."""
        damage, maps = self.evidence.damage, self.evidence.held_out.edited.maps
        is_found, scores = np.zeros(len(damage), np.bool_), np.empty(len(damage))
        for held, spread in self.folds:
            rows = np.flatnonzero(np.isin(damage.press, held))
            relative = self._relate(spread, maps[rows])
            is_found[rows] = ((relative > 1) & damage.masks[rows]).any(axis=(1, 2))
            scores[rows] = _highest(relative)
        return is_found, scores

    @property
    def found(self) -> float:
        """The share of the rendered damage that lies above the limit."""
        return float(self.damaged[0].mean())

    def finish(self) -> OtherLimit:
        """Return the limit; a press lies above 1 where its standardised score lies above the threshold of those."""
        scores = _highest(self._relate(self.spread, self.evidence.known.maps))
        for held, spread in self.folds:
            apart = _highest(self._relate(spread, self.evidence.held_out.sound.maps[held]))
            scores[held] = np.maximum(scores[held], apart)
        words = f"compared with {self.kind.about}; {self.threshold.method}"
        changed = {"value": 1.0, "method": words, "nominal_scores": tuple(map(float, np.sort(scores)))}
        threshold = self.threshold.model_copy(update=changed)
        return OtherLimit(self._limit(self.spread), threshold, scores, self.damaged[1])


def choose_limit(evidence: Evidence, kinds: Sequence[LimitKind] = KINDS) -> Choice:
    """Choose the kind that finds most: the first among equals, the plain one unless another finds WORTH more."""
    if not evidence.is_score_a_maximum:
        return Choice(PLAIN, "the method's score is not the highest value of its map")
    above = (evidence.held_out.edited.maps > evidence.plain.value) & evidence.damage.masks
    usual = float(above.any(axis=(1, 2)).mean())
    found, best = {PLAIN.name: usual}, None
    for kind in (one for one in kinds if one is not PLAIN):
        candidate = _Candidate(kind, evidence)
        if not candidate.is_usable:
            continue
        found[kind.name] = candidate.found
        if candidate.found > (best.found if best else usual):
            best = candidate
    count = len(evidence.damage)
    plainly = f"{round(usual * count)} of {count} small pieces of rendered damage"
    if best is None or best.found < usual + WORTH:
        return Choice(PLAIN, f"it finds {plainly}, and no other limit clearly more", None, found)
    more = f"{round(best.found * count)} of {count} small pieces of rendered damage"
    return Choice(best.kind, f"finds {more}, one limit for all places {plainly}", best.finish(), found)


def _highest(maps: Float) -> Float:
    return np.asarray(maps.max(axis=(1, 2)))
