"""The threshold, from nominal presses alone: out-of-fold scores and a conformal quantile that counts pieces.

Ref: Vovk, Gammerman, Shafer, Algorithmic Learning in a Random World (2005), section 2 (the quantile); Vovk,
Cross-conformal predictors, Annals of Mathematics and AI 74 (2015) (scores from folds); Lee, Barber, Willett,
Distribution-free inference with hierarchical data (2023), arXiv:2306.06342 (pieces with several presses each).

Presses of one piece are similar, so a new piece counts as one draw for any number of presses. Every piece has the
weight 1 / (pieces + 1), shared by its presses; the same weight is at infinity, for the new piece. A press of a new
piece exceeds the (1 - alpha) quantile of these weighted scores with probability alpha at most. With one press each
that is the ceil((n + 1)(1 - alpha))-th smallest of n scores.

The probability is over bundles: one bundle's own rate differs from it. What is promised of one bundle is the exact
binomial limit of the presses, and of the pieces, above its threshold (`by_press`, `by_piece`). It is a quantile of the
same distribution as `rate_range`, so the two statements cannot contradict each other: the one is a mean over bundles,
the other a limit for 90 of 100 bundles. Where pieces have several presses, how many of them lie above the threshold
is random, and the limit by piece is approximate. With folds it is approximate
(Vovk's cross-conformal scores have no exact bound). A fold has fewer presses than the final bank and the same share of
the bank's size (`Nominal.room`), so its scores are usually higher. They are equal where a method divides them by
distances measured in the same fold (SPADE). tests/bench/test_false_alarms.py measures the effect.
"""

import math
from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.nominal_presses import MIN_PRESSES
from edge.core.arrays import F64
from edge.core.binomial import CONFIDENCE, beta_quantile, upper_rate
from edge.core.errors import FitError
from edge.core.printable import write_count
from edge.model.manifest import RatePromise, ThresholdEntry

__all__ = [
    "FEWEST_PIECES",
    "FLOOR_MARGIN",
    "check_alpha",
    "conformal_threshold",
    "count_alarms",
    "count_needed",
    "limit_promise",
    "of_copies",
    "pieces_of",
    "promise_at",
    "promise_known_pieces",
    "rate_range",
    "require_enough",
]

FLOOR_MARGIN = 0.25
"""Where n pieces cannot promise the requested rate, the largest score is raised by this share of the distance from
the median to it, or by less where the rate is near. A choice, not a theorem: it trades some sensitivity for fewer false
alarms."""

FEWEST_PIECES = 4
"""Of fewer pieces nothing is promised of others: three do not show how far pieces differ. Of a real ball 12 of 15
further presses failed after a fit of three."""

COPIES_MARGIN = 1.3
"""Other pieces score higher than copies of one: docs/detectors.md has the false alarms with this factor."""

RANGE = 0.95
"""The probability that one bundle's own false-alarm rate is in the stated range."""

# In exact arithmetic (n + 1) alpha may be an integer that floats miss by rounding.
ROUNDING = 1e-9


def conformal_threshold(
    scores: Sequence[float] | F64,
    alpha: float,
    slack: float = 0.0,
    kind: str = "cross-conformal",
    specimens: Sequence[str | None] = (),
    fewest: int = MIN_PRESSES,
) -> ThresholdEntry:
    """The threshold at which a press of a new sound piece fails with probability alpha at most, if the pieces allow it.

    scores: anomaly scores of nominal presses by banks without them. slack: smallest margin above the largest score
    where the floor holds; the numerical tolerance. kind: how the scores were made, for the record.
    specimens: the piece of each press, None where unknown: such a press counts as its own piece.
    fewest: presses that a threshold needs. Of few pieces nothing is promised of others.
    Errors: FitError for fewer scores.
    """
    check_alpha(alpha)
    score_array = np.asarray(scores, np.float64)
    require_enough(len(score_array), alpha, fewest)
    if not np.isfinite(score_array).all():
        raise FitError("a nominal press has a score that is not finite; look at the pictures")
    keys = pieces_of(specimens or (None,) * len(score_array))
    order = np.argsort(score_array, kind="stable")
    ordered, pieces = score_array[order], len(set(keys))
    rank = _rank([keys[k] for k in order], alpha)
    if rank is not None:
        value, method = float(ordered[rank - 1]), f"{kind} quantile, rank {rank} of {len(ordered)}"
    else:
        margin = max(_margin_share(pieces, alpha) * float(ordered[-1] - np.median(ordered)), slack)
        value = float(ordered[-1]) + margin
        method = f"{kind}: largest of {len(ordered)} scores plus {margin:.4g}"
    high = np.flatnonzero(score_array > value).tolist()
    threshold = ThresholdEntry(
        value=value,
        method=method,
        alpha=alpha,
        alpha_floor=1 / (pieces + 1),
        nominal_scores=tuple(map(float, ordered)),
        pieces=pieces,
        rate_range=rate_range(pieces, alpha),
        by_press=_promise(len(high), len(score_array)),
        by_piece=_promise(len({keys[k] for k in high}), pieces) if pieces < len(score_array) else None,
    )
    return promise_known_pieces(threshold) if pieces < FEWEST_PIECES else threshold


def _promise(alarms: int, trials: int) -> RatePromise:
    """Return the rates that so many alarms among these trials still allow."""
    rate = upper_rate(alarms, trials, CONFIDENCE)
    return RatePromise(trials=trials, alarms=alarms, rate=rate, confidence=CONFIDENCE)


def count_alarms(
    limit: ThresholdEntry,
    scores: Sequence[float] | F64,
    specimens: Sequence[str | None] = (),
) -> ThresholdEntry:
    """Promise what these scores of its presses show: how many presses, and pieces, lie above the limit's value."""
    keys = pieces_of(specimens or (None,) * len(scores))
    most = limit.value + ROUNDING * abs(limit.value)
    high = [key for key, score in zip(keys, scores, strict=True) if score > most]
    by_piece = None if limit.by_piece is None else _promise(len(set(high)), len(set(keys)))
    return limit.model_copy(update={"by_press": _promise(len(high), len(keys)), "by_piece": by_piece})


def promise_at(
    scores: Sequence[float] | F64,
    value: float,
    alpha: float,
    specimens: Sequence[str | None] = (),
) -> ThresholdEntry | None:
    """State what a limit of this value promises: the smallest rate, from alpha on, whose own threshold is no higher.
    None where every rate's is. Parameters and errors otherwise as `conformal_threshold`."""
    pieces = len(set(pieces_of(specimens or (None,) * len(scores))))
    steps = (k / (pieces + 1) for k in range(1, pieces + 1))
    for rate in (alpha, *(step for step in steps if step > alpha)):
        threshold = conformal_threshold(scores, rate, specimens=specimens)
        if threshold.value <= value:
            return count_alarms(threshold.model_copy(update={"value": value}), scores, specimens)
    return None


def _rank(pieces: Sequence[str], alpha: float) -> int | None:
    """Which of the scores, counted from 1, is the threshold; None where no score is high enough.

    pieces: of each press, in the order of their scores.
    """
    presses = {piece: pieces.count(piece) for piece in set(pieces)}
    below = accumulate(1 / presses[piece] for piece in pieces)
    wanted = (len(presses) + 1) * (1 - alpha) - ROUNDING
    return next((rank for rank, weight in enumerate(below, 1) if weight >= wanted), None)


def _margin_share(pieces: int, alpha: float) -> float:
    """Return the share of the distance from the median to the largest score by which the limit lies above that.

    Where scores fall off exponentially, the largest of n lies ln((n + 1) / 2) scales above the median, and the rate
    alpha ln(1 / (alpha (n + 1))) scales further. With a quarter at 12 to 18 of real and simulated presses 5.0 to 3.1 %
    of others fail for a requested 5 %, with this 5.1 to 5.6 %.
    """
    return min(FLOOR_MARGIN, math.log(1 / (alpha * (pieces + 1))) / math.log(max(pieces + 1, 3) / 2))


def count_needed(alpha: float) -> int:
    """Count the pieces that promise this rate."""
    return math.ceil(1 / alpha - ROUNDING) - 1


def require_enough(presses: int, alpha: float, fewest: int = MIN_PRESSES, why: str = "") -> None:
    """Check that a fold keeps enough presses. Errors: FitError for too few.

    fewest: with copies of them, fewer are enough. why: why there are no copies.
    """
    if presses < fewest:
        raise FitError(
            f"{write_count(presses, 'nominal press')} give{'s' if presses == 1 else ''} no threshold: "
            f"with one held out fewer than {MIN_PRESSES - 1} are left to learn from; give at least {MIN_PRESSES} "
            f"({count_needed(alpha)} for a false-alarm rate of {alpha:g}), or state a threshold yourself"
            f"{why and f'; {why}'}"
        )


def of_copies(scores: Sequence[float] | F64, alpha: float) -> ThresholdEntry:
    """The threshold of a single press: above its copies, which no bank has learnt. It promises no rate.

    scores: of the copies.
    """
    highest = float(np.max(scores))
    return ThresholdEntry(
        value=highest * COPIES_MARGIN,
        method=f"{COPIES_MARGIN:g} times the highest score of {len(scores)} copies of the one press",
        alpha=alpha,
        alpha_floor=1.0,
        nominal_scores=(),
    )


def limit_promise(
    threshold: ThresholdEntry, specimens: Sequence[str | None], folds: Sequence[NDArray[np.int64]]
) -> ThresholdEntry:
    """Promise nothing of new pieces where presses of a piece are in several folds: its scores do not count as new.

    specimens: the piece of each press, (n,). folds: the presses that were held out together.
    """
    keys = np.array(pieces_of(specimens))
    if sum(len(set(keys[held])) for held in folds) == len(set(keys)):
        return threshold
    return promise_known_pieces(threshold)


def promise_known_pieces(threshold: ThresholdEntry) -> ThresholdEntry:
    """Promise nothing of other pieces than those of the presses."""
    return threshold.model_copy(update={"alpha_floor": 1.0, "rate_range": None, "by_piece": None})


def rate_range(pieces: int, alpha: float) -> tuple[float, float]:
    """The two rates between which one bundle's own false-alarm rate is, with the probability RANGE.

    The rate above the r-th smallest of n scores has the distribution Beta(n + 1 - r, r), for any scores
    (Vovk, Conditional validity of inductive conformal predictors, 2012). Exact for one press of each piece and scores
    without folds; above the largest score of all it is an upper limit.
    """
    rank = math.ceil((pieces + 1) * (1 - alpha) - ROUNDING)
    if rank > pieces:
        return 0.0, beta_quantile(RANGE, 1, pieces)
    tail = (1 - RANGE) / 2
    shape = pieces + 1 - rank, rank
    return beta_quantile(tail, *shape), beta_quantile(1 - tail, *shape)


def check_alpha(alpha: float) -> None:
    """Check a false-alarm rate. Errors: FitError for an invalid one."""
    if not 0 < alpha < 1:
        raise FitError(f"the false-alarm rate lies between 0 and 1, found {alpha}; 0.05 is one in twenty")


def pieces_of(specimens: Sequence[str | None]) -> list[str]:
    """The piece of each press; a press without a specimen is its own piece."""
    return [f"press {k}" if name is None else f"specimen {name}" for k, name in enumerate(specimens)]
