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

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.limits.map_limit import KINDS, PLACES, PLAIN, Limit, Spread, learn_spread, relate
from calibration.fitting.limits.threshold import conformal_threshold, pieces_of
from edge.core.press_again import KnownScores
from edge.model.again_facts import PRESS_AGAIN, score_facts
from edge.model.manifest import ThresholdEntry

__all__ = ["WORTH", "Choice", "Evidence", "OtherLimit", "choose_limit"]

Float = NDArray[np.float64]

WORTH = 0.05
"""A kind of limit has to find this share of the rendered damage more than the plain limit."""

# Where the largest value of a map is not the press's score to this share, the score is something else.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class OtherLimit:
    """A limit other than the plain one."""

    limit: Limit
    threshold: ThresholdEntry
    """At 1."""
    scores: Float
    """Scores of the nominal presses in units of the limit, (n,)."""
    damaged: Float
    """Scores of the presses with rendered damage, (m,)."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The kind of limit that a bundle has, and why."""

    kind: str
    why: str
    other: OtherLimit | None = None
    """None for the plain limit."""
    found: Mapping[str, float] = field(default_factory=dict)
    """The share of the rendered damage that each kind finds, by its name; empty where nothing was compared."""

    def facts(self) -> dict[str, Any]:
        """Return the choice for the manifest."""
        shares = {name: round(share, 4) for name, share in self.found.items()}
        return {"kind": self.kind, "why": self.why, "found": shares}


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
    is_placed: bool = True
    """Whether parts lie at one place; where they lie anywhere the next one lies where no range is known."""

    @property
    def scores(self) -> Float:
        """Scores of the nominal presses by the plain limit, (n,)."""
        return np.maximum(self.held_out.sound.scores, self.known.scores)

    @cached_property
    def plain(self) -> ThresholdEntry:
        return conformal_threshold(self.scores, self.alpha, specimens=self.specimens)

    @property
    def is_score_a_maximum(self) -> bool:
        sound = self.held_out.sound
        return bool(np.allclose(sound.highest(sound.maps), sound.scores, rtol=_SAME, atol=0))

    def count_found(self, choice: Choice, threshold: float) -> tuple[int, int]:
        """Count the presses with rendered damage that are found, and all of them.

        threshold: the score that a press fails above, where the choice has not counted them.
        """
        above = float((self.held_out.edited.scores > threshold).mean())
        return round(choice.found.get(choice.kind, above) * len(self.damage)), len(self.damage)

    def press_again_facts(self, choice: Choice, scores: Float) -> dict[str, Any]:
        """Return what a station needs to know whether one more press pays.

        scores: of the nominal presses, in units of the bundle's score.
        """
        damaged = choice.other.damaged if choice.other else self.held_out.edited.scores
        names = tuple(dict.fromkeys(self.damage.names))
        of = np.array([names.index(name) for name in self.damage.names])
        groups = tuple(tuple(damaged[of == k].tolist()) for k in range(len(names)))
        keys = np.array(pieces_of(self.specimens))
        sound = tuple(tuple(scores[keys == piece].tolist()) for piece in dict.fromkeys(keys.tolist()))
        return {PRESS_AGAIN: score_facts(KnownScores(sound, groups), names)}


class _Candidate:
    """One kind of limit, learnt from the evidence."""

    def __init__(self, kind: str, evidence: Evidence) -> None:
        self.kind, self.evidence = kind, evidence
        sound, known = evidence.held_out.sound, evidence.known
        self.spread = self._learn(sound)
        scores = known.highest(self.spread.standardise(known.maps))
        self.folds: list[tuple[NDArray[np.int64], Spread]] = []
        for held in evidence.folds:
            others = np.setdiff1d(np.arange(len(scores)), held)
            without = self._learn(sound.choose(others)) if kind == PLACES else self.spread
            self.folds.append((held, without))
            apart = sound.choose(held)
            scores[held] = np.maximum(scores[held], apart.highest(without.standardise(apart.maps)))
        self.threshold = conformal_threshold(scores, evidence.alpha, specimens=evidence.specimens)

    def _learn(self, presses: ScoredPresses) -> Spread:
        return learn_spread(self.kind, presses.maps, self.evidence.pixels_per_mm, presses.seen)

    def _limit(self, spread: Spread) -> Limit:
        return spread.limit(self.threshold.value, self.evidence.plain.value)

    @property
    def is_usable(self) -> bool:
        """The limit is positive, and a black frame fails by it if it fails by the plain one."""
        plain, black = self.evidence.plain.value, self.evidence.black
        if not (self.threshold.value > 0 and plain > 0):
            return False
        if black is None or black.scores[0] <= plain:
            return True
        return bool(black.highest(relate(self._limit(self.spread), black.maps))[0] > 1)

    @cached_property
    def damaged(self) -> tuple[NDArray[np.bool_], Float]:
        """The damage that is found by the limit without its press, bool (m,), and the scores in units of that, (m,)."""
        damage, edited = self.evidence.damage, self.evidence.held_out.edited
        is_found, scores = np.zeros(len(damage), np.bool_), np.empty(len(damage))
        for held, spread in self.folds:
            rows = np.flatnonzero(np.isin(damage.press, held))
            if not rows.size:
                continue
            shown = edited.choose(rows)
            relative = shown.weigh(relate(self._limit(spread), shown.maps))
            is_found[rows] = ((relative > 1) & damage.masks[rows]).any(axis=(1, 2))
            scores[rows] = relative.max(axis=(1, 2))
        return is_found, scores

    @property
    def found(self) -> float:
        """The share of the rendered damage that lies above the limit."""
        return float(self.damaged[0].mean())

    def finish(self) -> OtherLimit:
        """Return the limit; a press lies above 1 where its standardised score lies above the threshold of those."""
        limit = self._limit(self.spread)
        known, sound = self.evidence.known, self.evidence.held_out.sound
        scores = known.highest(relate(limit, known.maps))
        for held, spread in self.folds:
            apart = sound.choose(held)
            scores[held] = np.maximum(scores[held], apart.highest(relate(self._limit(spread), apart.maps)))
        words = f"compared with {KINDS[self.kind]}; {self.threshold.method}"
        changed = {"value": 1.0, "method": words, "nominal_scores": tuple(map(float, np.sort(scores)))}
        return OtherLimit(limit, self.threshold.model_copy(update=changed), scores, self.damaged[1])


def choose_limit(evidence: Evidence) -> Choice:
    """Choose the kind that finds most: the first among equals, the plain one unless another finds WORTH more."""
    if not evidence.is_score_a_maximum:
        return Choice(PLAIN, "the method's score is not the highest value of its map")
    edited = evidence.held_out.edited
    above = (edited.weigh(edited.maps) > evidence.plain.value) & evidence.damage.masks
    usual = float(above.any(axis=(1, 2)).mean())
    found, best = {PLAIN: usual}, None
    for kind in KINDS:
        if kind == PLAIN or (kind == PLACES and not evidence.is_placed):
            continue
        candidate = _Candidate(kind, evidence)
        if not candidate.is_usable:
            continue
        found[kind] = candidate.found
        if candidate.found > (best.found if best else usual):
            best = candidate
    count = len(evidence.damage)
    plainly = f"{round(usual * count)} of {count} small pieces of rendered damage"
    if best is None or best.found < usual + WORTH:
        return Choice(PLAIN, f"it finds {plainly}, and no other limit clearly more", None, found)
    more = f"{round(best.found * count)} of {count} small pieces of rendered damage"
    return Choice(best.kind, f"finds {more}, one limit for all places {plainly}", best.finish(), found)
