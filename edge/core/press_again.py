"""Whether one more press of a piece pays, and what two presses say together.

A press whose score lies a little above the threshold is `unsure`, and the same piece is pressed once more, shifted.
Every piece that fails would have failed by its first press alone, so the false-alarm rate that the threshold promises
holds for two presses as well, whatever they have in common. What is risked is damage that the first press shows and the
second does not.

Damage stays at its place on the part, and what makes the scores of sound presses high - noise, dust on the gel - does
not. So where both presses are registered, what both show at one place is decided, and `AGREED` of the threshold is
enough for it. Otherwise the lower of the two scores is.

How far above the threshold a second press is asked for is the bound at which the expected cost of a piece is smallest:

    cost = (1 - d) F P(sound fails) + d M P(damaged passes) + p (expected presses - 1)

with d the share of damaged pieces, and F, M, p the costs of a false alarm, of missed damage and of a press.

Sound presses above the threshold are rare, so their tail is taken as exponential beyond it (Pickands 1975, Balkema and
de Haan 1974), with the promised rate at the threshold and the mean excess of the highest nominal scores. Two presses of
a sound piece have a Gaussian copula with the correlation of the nominal presses of one piece. Two presses of a damaged
piece are two draws from the scores of the same kind and size of rendered damage. It is computed for the lower score.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Final

import numpy as np

from edge.core.arrays import F32, F64, Mask
from edge.core.press import AGREED
from edge.core.verdict import Kind, Verdict

__all__ = [
    "Costs",
    "KnownScores",
    "Plan",
    "SeenScores",
    "is_asked",
    "plan",
    "score_both",
    "second_verdict",
    "unsure",
]

# The highest share of the nominal scores gives the tail's scale, from at least this number of them.
_TAIL_SHARE: Final = 0.25
_TAIL_FEWEST: Final = 4
# Bounds that are tried, evenly over the damaged scores above the threshold.
_BOUNDS: Final = 40
# Steps of the integral over the first press of a sound piece.
_STEPS: Final = 100
_MOST_CORRELATED: Final = 0.999

_NORMAL: Final = NormalDist()


@dataclass(frozen=True)
class Costs:
    """In any one unit."""

    missed: float
    """A damaged piece that passes."""
    false_alarm: float
    """A sound piece that fails."""
    press: float
    """One more press, in time and gel."""
    defect_rate: float
    """The share of damaged pieces."""

    def __post_init__(self) -> None:
        if min(self.missed, self.false_alarm, self.press) < 0 or not 0 <= self.defect_rate <= 1:
            raise ValueError(f"costs are not negative and a share lies in [0, 1], found {self}")


@dataclass(frozen=True)
class KnownScores:
    """What `fit` knows."""

    sound: tuple[tuple[float, ...], ...]
    """Scores of nominal presses by banks without them, piece by piece."""
    damaged: tuple[tuple[float, ...], ...]
    """Scores of presses with rendered damage, for each kind and size."""


@dataclass(frozen=True)
class Plan:
    """What one more press is expected to bring.

    false_alarms, misses: shares of sound and of damaged pieces, with one press and as planned.
    """

    why: str
    bound: float | None = None
    """It is asked for from the threshold up to this score; None where it never pays, and `why` says so."""
    presses: float = 1.0
    """The expected presses of a piece."""
    false_alarms: tuple[float, float] = (0.0, 0.0)
    misses: tuple[float, float] = (0.0, 0.0)


def is_asked(verdict: Verdict, bound: float | None) -> bool:
    """Tell whether a first press asks for a second one: its score does not pass, and is not above the bound."""
    if bound is None or verdict.kind not in (Kind.FAIL, Kind.UNSURE):
        return False
    score, threshold, tolerance = verdict.score, verdict.threshold, verdict.tolerance
    if score is None or threshold is None or tolerance is None:
        return False
    return threshold - tolerance <= score <= bound


def unsure(verdict: Verdict) -> Verdict:
    """The verdict on a first press that asks for a second one."""
    return Verdict(Kind.UNSURE, verdict.score, verdict.threshold, verdict.tolerance)


@dataclass(frozen=True, eq=False)
class SeenScores:
    """What a press shows, place by place of the part."""

    scores: F32
    """Its score map in the bank's pose, (h, w)."""
    is_judged: Mask
    """Places that were seen and judged, (h, w)."""


def score_both(first: SeenScores, second: SeenScores) -> float:
    """The score that two presses of a piece give together: the highest that both show at one place, by `AGREED`.

    A place that one of them did not judge is decided by the other. Errors: ValueError where none was judged.
    """
    first_scores = np.where(first.is_judged, first.scores, second.scores)
    other = np.where(second.is_judged, second.scores, first.scores)
    shown = np.minimum(first_scores, other)[first.is_judged | second.is_judged]
    if not len(shown):
        raise ValueError("no place of the part was judged")
    return float(shown.max()) / AGREED


def second_verdict(
    second: Verdict, first_score: float, both_score: float | None, decide: Callable[[float], Verdict]
) -> Verdict:
    """The verdict on a second press, with the score by which it is decided: `both_score`, or without it its own.

    both_score: as `score_both`; None for the lower of the two scores. decide: by the threshold. A second press that
    does not pass for another reason than its score does not pass by this. Errors: ValueError for one without a score.
    """
    if second.score is None:
        raise ValueError("a second press without a score is not decided")
    both = decide(min(first_score, second.score) if both_score is None else both_score)
    is_another = both.kind is Kind.PASS and second.kind is not decide(second.score).kind
    score = second.score if both_score is None else both_score
    return Verdict(second.kind if is_another else both.kind, score, second.threshold, second.tolerance)


def plan(known: KnownScores, threshold: float, rate: float, costs: Costs) -> Plan:
    """The bound with the smallest expected cost. rate: of sound presses above the threshold, as promised.

    Errors: ValueError for an impossible rate.
    """
    if not 0 < rate < 1:
        raise ValueError(f"the rate of false alarms lies between 0 and 1, found {rate}")
    correlation = _correlation(known.sound)
    if correlation is None:
        return Plan("no piece was pressed twice at the fit, so what a second press adds is not known")
    damaged = [np.asarray(scores, np.float64) for scores in known.damaged if scores]
    above = [scores[scores > threshold] for scores in damaged]
    if not any(len(scores) for scores in above):
        return Plan("no rendered damage of the fit lies above the threshold, so what is risked is not known")
    sound = _Tail(threshold, rate, _scale(known.sound), correlation)
    highest = max(float(scores.max()) for scores in above if len(scores))
    bounds = np.linspace(threshold, highest, _BOUNDS + 1)
    plans = [_at(bound, sound, damaged, costs) for bound in bounds]
    spent = [_cost(candidate, costs) for candidate in plans]
    best = int(np.argmin(spent))
    if best == 0:
        why = "at these costs a second press costs more than the false alarms that it saves"
        return replace(plans[0], why=why, bound=None, presses=1.0)
    return plans[best]


@dataclass(frozen=True)
class _Tail:
    """Scores of sound presses above the threshold: their share, an exponential scale, and the correlation of two
    presses of one piece."""

    threshold: float
    rate: float
    scale: float
    correlation: float

    def above(self, bound: float) -> float:
        """The share of sound presses above a bound that is not below the threshold."""
        return self.rate * math.exp(-(bound - self.threshold) / self.scale) if self.scale > 0 else 0.0

    def both(self, bound: float) -> float:
        """The share of sound pieces whose first press lies between threshold and bound, and the second above the
        threshold."""
        low, high = self.rate, self.above(bound)
        shares = high + (np.arange(_STEPS) + 0.5) / _STEPS * (low - high)
        edge, rest = -_NORMAL.inv_cdf(self.rate), math.sqrt(1 - self.correlation**2)
        second = [
            _NORMAL.cdf((-self.correlation * _NORMAL.inv_cdf(share) - edge) / rest)
            for share in shares.tolist()
        ]
        return float(np.mean(second)) * (low - high)


def _at(bound: float, sound: _Tail, damaged: Sequence[F64], costs: Costs) -> Plan:
    """Compute what is expected with this bound."""
    asked = sound.rate - sound.above(bound)
    false_alarms = sound.above(bound) + sound.both(bound)
    # Of pieces with one kind of damage: missed by the first press, pressed again, then missed.
    first = [float(np.mean(scores <= sound.threshold)) for scores in damaged]
    again = [float(np.mean((scores > sound.threshold) & (scores <= bound))) for scores in damaged]
    shares = [(miss, more, more * miss) for miss, more in zip(first, again, strict=True)]
    missed, asked_again, missed_again = np.mean(shares, axis=0).tolist()
    rate = costs.defect_rate
    return Plan(
        "",
        float(bound),
        1 + (1 - rate) * asked + rate * asked_again,
        (sound.rate, false_alarms),
        (missed, missed + missed_again),
    )


def _cost(one: Plan, costs: Costs) -> float:
    rate = costs.defect_rate
    wrong = (1 - rate) * costs.false_alarm * one.false_alarms[1] + rate * costs.missed * one.misses[1]
    return wrong + costs.press * (one.presses - 1)


def _scale(sound: Sequence[Sequence[float]]) -> float:
    """The mean excess of the highest nominal scores over the next one below."""
    ordered = np.sort(np.concatenate([np.asarray(scores, np.float64) for scores in sound]))[::-1]
    count = min(max(_TAIL_FEWEST, math.ceil(_TAIL_SHARE * len(ordered))), len(ordered) - 1)
    return float(np.mean(ordered[:count]) - ordered[count])


def _correlation(sound: Sequence[Sequence[float]]) -> float | None:
    """Compute the correlation of two presses of one piece: intraclass, of normal scores, between 0 and 1.

    None where no piece was pressed twice, or all presses are of one piece.
    """
    pieces = (
        np.concatenate([np.full(len(scores), k) for k, scores in enumerate(sound)]) if sound else np.empty(0)
    )
    several = [k for k, scores in enumerate(sound) if len(scores) > 1]
    if not several or len(sound) < 2:
        return None
    values = np.concatenate([np.asarray(scores, np.float64) for scores in sound])
    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    normal = np.array([_NORMAL.inv_cdf((rank + 0.5) / len(values)) for rank in ranks.tolist()])
    within = float(
        np.mean([np.var(normal[pieces == k], ddof=1) for k in several])  # unbiased for each piece
    )
    total = float(np.var(normal, ddof=1))
    return min(max(1 - within / total, 0.0), _MOST_CORRELATED) if total > 0 else None
