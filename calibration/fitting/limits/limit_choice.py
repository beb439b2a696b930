"""Which limit a bundle has: that by which banks without them find most of the damage rendered into nominal presses.

Every kind of limit gets the same chance of a false alarm: it is the conformal limit of the nominal presses' out-of-fold
scores. No label is used. A kind has to find clearly more than the plain limit.

Where a limit learns from the presses at each place, a press is compared with what the other folds show there: a press
that takes part in its own range looks more usual than the next one will.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.edited_presses import EditedPresses
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.limits.kinds import KINDS, PLAIN, LimitKind
from calibration.fitting.limits.map_limit import MapLimit, Spread, learn_spread
from calibration.fitting.limits.threshold import conformal_threshold
from edge.model.manifest import ThresholdEntry

__all__ = ["WORTH", "Choice", "Chosen", "Evidence", "choose_limit"]

Float = NDArray[np.float64]

WORTH = 0.05
"""A kind of limit has to find this share of the rendered damage more than the plain limit."""

# Where the largest value of a map is not the press's score to this share, the score is something else.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a limit is chosen from: raw maps and scores.

    known: of the nominal presses by the final bank, which knows them. black: of a black frame by it, which must not
    pass; None where the gateway refuses one for its colours.
    """

    held_out: HeldOut
    known: ScoredPresses
    black: ScoredPresses | None
    edited: EditedPresses
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


@dataclass(frozen=True, eq=False)
class Chosen:
    """A limit other than the plain one. threshold: at 1. scores: of the nominal presses in its units, float64 (n,).
    damaged: of those with rendered damage, float64 (m,)."""

    limit: MapLimit
    threshold: ThresholdEntry
    scores: Float
    damaged: Float


@dataclass(frozen=True, eq=False)
class Choice:
    """chosen: None for the plain limit. found: name of a kind to the share of the rendered damage that it finds."""

    kind: LimitKind
    why: str
    chosen: Chosen | None = None
    found: Mapping[str, float] | None = None

    def facts(self) -> dict[str, Any]:
        """For the manifest."""
        shares = {} if self.found is None else {name: round(share, 4) for name, share in self.found.items()}
        return {"kind": self.kind.name, "why": self.why, "found": shares}


class _Candidate:
    """One kind of limit, learnt from the evidence."""

    def __init__(self, kind: LimitKind, evidence: Evidence) -> None:
        self.kind, self.evidence = kind, evidence
        maps = evidence.held_out.sound.maps
        self.spread = learn_spread(kind, maps, evidence.pixels_per_mm)
        self.without = [self._without(held, maps) for held in evidence.folds]
        found = np.empty(len(maps))
        for held, spread in zip(evidence.folds, self.without, strict=True):
            found[held] = _highest(spread.standardised(maps[held]))
        known = _highest(self.spread.standardised(evidence.known.maps))
        self.scores = np.maximum(found, known)
        self.threshold = conformal_threshold(self.scores, evidence.alpha, specimens=evidence.specimens)

    def _without(self, held: NDArray[np.int64], maps: NDArray[np.float32]) -> Spread:
        if not self.kind.is_by_place:
            return self.spread
        kept = np.setdiff1d(np.arange(len(maps)), held)
        return learn_spread(self.kind, maps[kept], self.evidence.pixels_per_mm)

    def limit(self, spread: Spread) -> MapLimit:
        return spread.limited(self.threshold.value, self.evidence.plain.value)

    @property
    def is_usable(self) -> bool:
        """Whether the limit is positive, and a black frame fails by it if it fails by the plain one."""
        evidence = self.evidence
        if not (self.threshold.value > 0 and evidence.plain.value > 0):
            return False
        black = evidence.black
        if black is None or black.scores[0] <= evidence.plain.value:
            return True
        return bool(_highest(self.limit(self.spread).relative(black.maps))[0] > 1)

    def found(self) -> float:
        """The share of the rendered damage that lies above the limit."""
        edited = self.evidence.edited
        is_found = np.zeros(len(edited), np.bool_)
        for held, spread in zip(self.evidence.folds, self.without, strict=True):
            rows = np.flatnonzero(np.isin(edited.press, held))
            relative = self.limit(spread).relative(self.evidence.held_out.edited.maps[rows])
            is_found[rows] = ((relative > 1) & edited.near[rows]).any(axis=(1, 2))
        return float(is_found.mean())

    def chosen(self) -> Chosen:
        """A press lies above 1 where its standardised score lies above the limit of those."""
        limit, scores = self.limit(self.spread), self._relative()
        words = f"compared with {self.kind.about}; {self.threshold.method}"
        changed = {"value": 1.0, "method": words, "nominal_scores": tuple(map(float, np.sort(scores)))}
        return Chosen(limit, self.threshold.model_copy(update=changed), scores, self._damaged())

    def _damaged(self) -> Float:
        """The scores of presses with rendered damage, in units of the limit without the press, float64 (m,)."""
        edited, scores = self.evidence.edited, np.empty(len(self.evidence.edited))
        for held, spread in zip(self.evidence.folds, self.without, strict=True):
            rows = np.flatnonzero(np.isin(edited.press, held))
            scores[rows] = _highest(self.limit(spread).relative(self.evidence.held_out.edited.maps[rows]))
        return scores

    def _relative(self) -> Float:
        """The nominal presses' scores in units of the limit, the higher of two each."""
        scores = _highest(self.limit(self.spread).relative(self.evidence.known.maps))
        for held, spread in zip(self.evidence.folds, self.without, strict=True):
            apart = _highest(self.limit(spread).relative(self.evidence.held_out.sound.maps[held]))
            scores[held] = np.maximum(scores[held], apart)
        return scores


def choose_limit(evidence: Evidence, kinds: Sequence[LimitKind] = KINDS) -> Choice:
    """The kind that finds most; the first among equals, and the plain one unless another finds WORTH more."""
    if not evidence.is_score_a_maximum:
        return Choice(PLAIN, "the method's score is not the highest value of its map")
    found = {PLAIN.name: _plainly_found(evidence)}
    best: _Candidate | None = None
    for kind in (one for one in kinds if one is not PLAIN):
        candidate = _Candidate(kind, evidence)
        if not candidate.is_usable:
            continue
        found[kind.name] = candidate.found()
        if found[kind.name] > found[best.kind.name if best else PLAIN.name]:
            best = candidate
    usual = found[PLAIN.name]
    if best is None or found[best.kind.name] < usual + WORTH:
        return Choice(
            PLAIN, f"it finds {_share(usual, evidence)}, and no other limit clearly more", None, found
        )
    why = (
        f"finds {_share(found[best.kind.name], evidence)}, one limit for all places {_share(usual, evidence)}"
    )
    return Choice(best.kind, why, best.chosen(), found)


def _plainly_found(evidence: Evidence) -> float:
    above = (evidence.held_out.edited.maps > evidence.plain.value) & evidence.edited.near
    return float(above.any(axis=(1, 2)).mean())


def _share(share: float, evidence: Evidence) -> str:
    count = len(evidence.edited)
    return f"{round(share * count)} of {count} small pieces of rendered damage"


def _highest(maps: Float) -> Float:
    return np.asarray(maps.max(axis=(1, 2)))
