"""Agreement of verdicts: of an operator with himself, between operators, and with what is known of the pieces.

Ref: AIAG, Measurement Systems Analysis, 4th edition, chapter III, section C (attribute study, hypothesis test analyses
with kappa, effectiveness); Cohen, Educational and Psychological Measurement 20 (1960); Fleiss, Psychological Bulletin
76 (1971). Standard errors of a kappa against chance: Fleiss, Cohen and Everitt, Psychological Bulletin 72 (1969).

`unsure` is a verdict of its own. It is not a pass: on a bad piece it is no miss, on a good one it is a false alarm, and
it is never a correct decision.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.binomial import rate_limits

__all__ = ["Kappa", "Share", "Shares", "Words", "cohen_kappa", "count_shares", "fleiss_kappa"]

Words = NDArray[np.str_]


class Share(NamedTuple):
    """`found` of `of`; nothing to count where that is 0."""

    found: int
    of: int

    @property
    def limits(self) -> tuple[float, float] | None:
        """The exact limits of Clopper and Pearson at 95 %."""
        return rate_limits(self.found, self.of, 0.975) if self.of else None


class Shares(NamedTuple):
    """How decisions on pieces agree. All but the first are None where nothing is known of the pieces."""

    same: Share
    """Pieces with one verdict in all repeats."""
    effectiveness: Share | None = None
    """Pieces with the right verdict in all repeats."""
    misses: Share | None = None
    """Passes among the decisions on bad pieces."""
    false_alarms: Share | None = None
    """Other verdicts than a pass among the decisions on good pieces."""


class Kappa(NamedTuple):
    """Agreement beyond chance: 1 complete, 0 as by chance."""

    value: float | None
    """None where only one verdict occurs: every agreement is then by chance, and kappa is not defined."""
    observed: float
    """A share of agreement, as `expected`."""
    expected: float
    standard_error: float | None = None
    """Without agreement beyond chance."""


def count_shares(decisions: Words, known: Sequence[str] | None) -> Shares:
    """Count verdicts (pieces, decisions). known: of each piece, `pass` or `fail`; None where that is not known."""
    same = _share((decisions == decisions[:, :1]).all(axis=1))
    if known is None:
        return Shares(same)
    truth = np.array(known)
    right = _share((decisions == truth[:, None]).all(axis=1))
    return Shares(
        same,
        right,
        _share(decisions[truth == "fail"] == "pass"),
        _share(decisions[truth == "pass"] != "pass"),
    )


def _share(flags: NDArray[np.bool_]) -> Share:
    return Share(int(flags.sum()), flags.size)


def cohen_kappa(first: Words, second: Words) -> Kappa:
    """Compare two series of decisions about the same things, of one shape."""
    first, second = first.ravel(), second.ravel()
    words = np.union1d(first, second)
    p, q = ((series[:, None] == words).mean(axis=0) for series in (first, second))
    expected = float(p @ q)
    variance = expected + expected**2 - float((p * q) @ (p + q))
    return _kappa(float((first == second).mean()), expected, variance, len(first))


def fleiss_kappa(decisions: Words) -> Kappa:
    """Compare all decisions about each thing, (things, decisions), at least two."""
    n, m = decisions.shape
    counts = (decisions[..., None] == np.unique(decisions)).sum(axis=1)
    observed = float((counts * (counts - 1)).sum() / (n * m * (m - 1)))
    p = counts.sum(axis=0) / (n * m)
    expected = float(p @ p)
    # Fleiss, Nee and Landis, Psychological Bulletin 86 (1979): the error of 1971 was too large.
    skew = float((p * (1 - p) * (1 - 2 * p)).sum())
    variance = 2 * ((1 - expected) ** 2 - skew) / (m * (m - 1))
    return _kappa(observed, expected, variance, n)


def _kappa(observed: float, expected: float, variance: float, n: int) -> Kappa:
    """variance: of the observed agreement of one thing, without agreement beyond chance."""
    if expected >= 1:
        return Kappa(None, observed, expected)
    error = math.sqrt(max(0.0, variance) / n) / (1 - expected)
    return Kappa((observed - expected) / (1 - expected), observed, expected, error)
