"""Which limit a bundle has, by the damage rendered into nominal presses that banks without them find.

Both kinds of limit get the same chance of a false alarm: the conformal threshold of the nominal presses' out-of-fold
scores. No label is used. The surroundings are taken unless the plain limit finds clearly more: in 15 fits (five real
ones, simulated parts; PaDiM and PatchCore) their map has an AU-PRO from 0.002 less to 0.071 more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.limits.map_limit import (
    PLAIN,
    SURROUNDINGS,
    WINDOW_MM,
    Limit,
    find_contrast,
    make_limit,
    make_window,
    relate,
)
from calibration.fitting.limits.threshold import conformal_threshold, count_alarms, pieces_of
from edge.core.arrays import F64, Mask
from edge.core.press_again import KnownScores
from edge.model.again_facts import PRESS_AGAIN, score_facts
from edge.model.manifest import ThresholdEntry

__all__ = ["WORTH", "Choice", "DamageFound", "Evidence", "choose_limit"]

WORTH = 0.05
"""A limit has to find this share of the rendered damage more than the usual one."""

# Where the largest value of a map is not the press's score to this share, the score is something else.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class OtherLimit:
    """A limit other than the plain one."""

    limit: Limit
    threshold: ThresholdEntry
    """At 1."""
    scores: F64
    """Scores of the nominal presses in units of the limit, (n,)."""
    damaged: F64
    """Scores of the presses with rendered damage, (m,)."""
    is_found: Mask
    """Of that damage what lies above the limit, (m,)."""


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


@dataclass(frozen=True)
class DamageFound:
    """How many presses with rendered damage a bundle finds."""

    found: int
    count: int
    why: str = ""
    """How many of the largest size of each kind."""
    sizes: str = ""
    """How many of every size."""


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

    @property
    def scores(self) -> F64:
        """Scores of the nominal presses by the plain limit, (n,)."""
        return np.maximum(self.held_out.sound.scores, self.known.scores)

    @cached_property
    def plain(self) -> ThresholdEntry:
        return conformal_threshold(self.scores, self.alpha, specimens=self.specimens)

    @property
    def is_score_a_maximum(self) -> bool:
        sound = self.held_out.sound
        return bool(np.allclose(sound.highest(sound.maps), sound.scores, rtol=_SAME, atol=0))

    def find_damage(self, exceeds: Mask) -> Mask:
        """Return the rendered damage on which a map exceeds its limit, bool (m,). exceeds: bool (m, h, w)."""
        return np.asarray((exceeds & self.damage.masks).any(axis=(1, 2)))

    @cached_property
    def is_found_plainly(self) -> Mask:
        """The rendered damage that the plain limit finds, (m,)."""
        edited = self.held_out.edited
        if not self.is_score_a_maximum:
            return np.asarray(edited.scores > self.plain.value)
        return self.find_damage(edited.weigh(edited.maps) > self.plain.value)

    def count_found(self, choice: Choice) -> DamageFound:
        """Count the presses with rendered damage that are found."""
        is_found = choice.other.is_found if choice.other else self.is_found_plainly
        kinds = {name.split()[0]: name for name in self.damage.names}  # the last size of each is the largest
        names = np.array(self.damage.names)
        sizes = [
            f"{name}: {is_found[names == name].sum()} of {(names == name).sum()}" for name in kinds.values()
        ]
        every = [
            f"{name} {is_found[names == name].sum()} of {(names == name).sum()}"
            for name in self._largest_first
        ]
        return DamageFound(int(is_found.sum()), len(self.damage), ", ".join(sizes), ", ".join(every))

    @property
    def _largest_first(self) -> list[str]:
        """Kinds and sizes of the damage, kind by kind, which has them in rising order."""
        names = list(dict.fromkeys(self.damage.names))[::-1]
        return sorted(names, key=lambda name: name.split()[0])

    def keep(self, presses: NDArray[np.int64]) -> "Evidence":
        """Keep these presses, in rising order, and the damage in them; the folds are gone."""
        rows = np.flatnonzero(np.isin(self.damage.press, presses))
        damage = self.damage.choose(rows.tolist())
        return replace(
            self,
            held_out=HeldOut(_choose(self.held_out.sound, presses), _choose(self.held_out.edited, rows)),
            known=_choose(self.known, presses),
            damage=replace(damage, press=np.searchsorted(presses, damage.press)),
            folds=[],
            specimens=[self.specimens[k] for k in presses],
        )

    def press_again_facts(self, choice: Choice, scores: F64) -> dict[str, Any]:
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


def _choose(scored: ScoredPresses, rows: NDArray[np.int64]) -> ScoredPresses:
    seen = None if scored.seen is None else scored.seen[rows]
    limits = None if scored.gel_limits is None else scored.gel_limits[rows]
    kept = ScoredPresses(scored.maps[rows], scored.scores[rows], seen=seen, gel_limits=limits)
    return kept if limits is None else replace(kept, scores=kept.highest(kept.maps))


def choose_limit(evidence: Evidence) -> Choice:
    """Choose the surroundings, but the plain limit where it finds WORTH more, or where neither finds anything."""
    if not evidence.is_score_a_maximum:
        return Choice(PLAIN, "the method's score is not the highest value of its map")
    count, usual = len(evidence.damage), float(evidence.is_found_plainly.mean())
    plainly = f"{round(usual * count)} of {count} small pieces of rendered damage"
    other = _compare_surroundings(evidence)
    if other is None:
        why = "by its surroundings a press has no limit above 0, or a black frame would pass"
        return Choice(PLAIN, f"it finds {plainly}; {why}", None, {PLAIN: usual})
    share = float(other.is_found.mean())
    shares, more = {PLAIN: usual, SURROUNDINGS: share}, f"{other.is_found.sum()} of {count}"
    if share == 0 or usual >= share + WORTH:
        return Choice(PLAIN, f"it finds {plainly}, compared with its surroundings {more}", None, shares)
    return Choice(SURROUNDINGS, f"finds {more}, one limit for all places {plainly}", other, shares)


def _compare_surroundings(evidence: Evidence) -> OtherLimit | None:
    """Make the limit by surroundings; None where it is not positive, or a black frame passes that fails plainly."""
    sound, known, black = evidence.held_out.sound, evidence.known, evidence.black
    window = make_window(sound.maps, evidence.pixels_per_mm)
    contrasts = [one.highest(find_contrast(window, one.maps)) for one in (sound, known)]
    threshold = conformal_threshold(np.maximum(*contrasts), evidence.alpha, specimens=evidence.specimens)
    plain = evidence.plain.value
    if not (threshold.value > 0 and plain > 0 and window["limit_usual"].item() > 0):
        return None
    limit = make_limit(window, threshold.value, plain)
    if black is not None and black.scores[0] > plain and not black.highest(relate(limit, black.maps))[0] > 1:
        return None
    scores = np.maximum(*(one.highest(relate(limit, one.maps)) for one in (sound, known)))
    words = f"compared with its surroundings ({WINDOW_MM:g} mm); {threshold.method}"
    changed = {"value": 1.0, "method": words, "nominal_scores": tuple(map(float, np.sort(scores)))}
    damaged = evidence.held_out.edited.weigh(relate(limit, evidence.held_out.edited.maps))
    return OtherLimit(
        limit,
        # Also a raw score above the guard is an alarm.
        count_alarms(threshold.model_copy(update=changed), scores, evidence.specimens),
        scores,
        damaged.max(axis=(1, 2)),
        evidence.find_damage(damaged > 1),
    )
