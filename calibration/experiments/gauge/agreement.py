"""Agreement of verdicts: of an operator with himself, between operators, and with what is known of the pieces.

Ref: AIAG, Measurement Systems Analysis, 4th edition, chapter III, section C (attribute study, hypothesis test analyses
with kappa, effectiveness); Cohen, Educational and Psychological Measurement 20 (1960); Fleiss, Psychological Bulletin
76 (1971). Standard errors of a kappa against chance: Fleiss, Cohen and Everitt, Psychological Bulletin 72 (1969).

`unsure` is a verdict of its own. It is not a pass: on a bad piece it is no miss, on a good one it is a false alarm, and
it is never a correct decision.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from edge.core.binomial import rate_limits

__all__ = ["Agreement", "Appraiser", "Kappa", "Share", "agreement", "cohen_kappa", "fleiss_kappa"]

GOOD: Final = "pass"
BAD: Final = "fail"


@dataclass(frozen=True)
class Share:
    """`found` of `of`, with the exact limits of Clopper and Pearson at 95 %. of 0: nothing to count."""

    found: int
    of: int

    @property
    def share(self) -> float | None:
        return self.found / self.of if self.of else None

    @property
    def limits(self) -> tuple[float, float] | None:
        return rate_limits(self.found, self.of, 0.975) if self.of else None


@dataclass(frozen=True)
class Kappa:
    """Agreement beyond chance: 1 complete, 0 as by chance. value None where only one verdict occurs: every agreement is
    then by chance, and kappa is not defined. observed, expected: shares of agreement."""

    value: float | None
    observed: float
    expected: float
    standard_error: float | None = None
    """Without agreement beyond chance."""


@dataclass(frozen=True)
class Appraiser:
    """One operator."""

    name: str
    within: Share
    """Pieces with one verdict in all repeats. The others are None where nothing is known of the pieces."""
    effectiveness: Share | None = None
    """Pieces with the right verdict in all repeats."""
    misses: Share | None = None
    """Passes among the decisions on bad pieces."""
    false_alarms: Share | None = None
    """Other verdicts than a pass among the decisions on good pieces."""
    kappa: Kappa | None = None
    """Agreement with the known verdicts."""


@dataclass(frozen=True)
class Agreement:
    """between: pieces on which all operators agree in all repeats. with_known: and rightly. pairs: Cohen's kappa of two
    operators, repeat by repeat. fleiss: of all decisions together. verdicts: how often each was given."""

    appraisers: tuple[Appraiser, ...]
    between: Share
    with_known: Share | None
    pairs: tuple[tuple[str, str, Kappa], ...]
    fleiss: Kappa
    verdicts: dict[str, int]


Verdicts = Sequence[Sequence[Sequence[str]]]
"""Pieces, operators, repeats: a verdict each, `pass`, `fail` or `unsure`."""


def agreement(verdicts: Verdicts, operators: Sequence[str], known: Sequence[str] | None = None) -> Agreement:
    """known: of each piece, `pass` or `fail`; None where that is not known. Errors: ValueError for pieces without a
    verdict, or another number of them."""
    if not verdicts or any(len(piece) != len(operators) for piece in verdicts):
        raise ValueError("each piece has a list of verdicts for each operator")
    if known is not None and len(known) != len(verdicts):
        raise ValueError(
            f"known has one verdict for each piece, found {len(known)} for {len(verdicts)} pieces"
        )
    of_operator = {name: [piece[n] for piece in verdicts] for n, name in enumerate(operators)}
    every = [[one for repeats in piece for one in repeats] for piece in verdicts]
    return Agreement(
        tuple(_appraiser(name, found, known) for name, found in of_operator.items()),
        _all_equal(every),
        None if known is None else _all_right(every, known),
        tuple(
            (one, other, cohen_kappa(_flat(of_operator[one]), _flat(of_operator[other])))
            for one, other in combinations(operators, 2)
        ),
        fleiss_kappa(every),
        dict(Counter(_flat(every)).most_common()),
    )


def cohen_kappa(first: Sequence[str], second: Sequence[str]) -> Kappa:
    """Two series of decisions about the same things. Errors: ValueError for none, or two lengths."""
    if not first or len(first) != len(second):
        raise ValueError(f"kappa needs two series of one length, found {len(first)} and {len(second)}")
    n = len(first)
    observed = sum(a == b for a, b in zip(first, second, strict=True)) / n
    a, b = Counter(first), Counter(second)
    shares = {word: (a[word] / n, b[word] / n) for word in {*a, *b}}
    expected = math.fsum(p * q for p, q in shares.values())
    spread = math.fsum(p * q * (p + q) for p, q in shares.values())
    return _kappa(observed, expected, expected + expected**2 - spread, n)


def fleiss_kappa(decisions: Sequence[Sequence[str]]) -> Kappa:
    """Things with the same number of decisions each, at least two. Errors: ValueError for other numbers."""
    raters = {len(one) for one in decisions}
    if len(raters) != 1 or min(raters) < 2:
        raise ValueError(
            f"kappa needs as many decisions about each piece, at least 2, found {sorted(raters)}"
        )
    m, n = raters.pop(), len(decisions)
    counts = [Counter(one) for one in decisions]
    words = sorted({word for one in counts for word in one})
    observed = math.fsum(sum(k * (k - 1) for k in one.values()) / (m * (m - 1)) for one in counts) / n
    shares = [sum(one[word] for one in counts) / (n * m) for word in words]
    expected = math.fsum(p * p for p in shares)
    # Fleiss, Nee and Landis, Psychological Bulletin 86 (1979): the error of 1971 was too large.
    skew = math.fsum(p * (1 - p) * (1 - 2 * p) for p in shares)
    variance = 2 * ((1 - expected) ** 2 - skew) / (m * (m - 1))
    return _kappa(observed, expected, variance, n)


def _kappa(observed: float, expected: float, variance: float, n: int) -> Kappa:
    """variance: of the observed agreement of one thing, without agreement beyond chance."""
    if expected >= 1:
        return Kappa(None, observed, expected)
    error = math.sqrt(max(0.0, variance) / n) / (1 - expected)
    return Kappa((observed - expected) / (1 - expected), observed, expected, error)


def _appraiser(name: str, found: Sequence[Sequence[str]], known: Sequence[str] | None) -> Appraiser:
    within = _all_equal(found)
    if known is None:
        return Appraiser(name, within)
    on_bad = [one for repeats, truth in zip(found, known, strict=True) for one in repeats if truth == BAD]
    on_good = [one for repeats, truth in zip(found, known, strict=True) for one in repeats if truth == GOOD]
    truths = [truth for repeats, truth in zip(found, known, strict=True) for _ in repeats]
    return Appraiser(
        name,
        within,
        _all_right(found, known),
        Share(sum(one == GOOD for one in on_bad), len(on_bad)),
        Share(sum(one != GOOD for one in on_good), len(on_good)),
        cohen_kappa(_flat(found), truths),
    )


def _all_equal(found: Sequence[Sequence[str]]) -> Share:
    return Share(sum(len(set(one)) == 1 for one in found), len(found))


def _all_right(found: Sequence[Sequence[str]], known: Sequence[str]) -> Share:
    return Share(sum(set(one) == {truth} for one, truth in zip(found, known, strict=True)), len(found))


def _flat(found: Sequence[Sequence[str]]) -> list[str]:
    return [one for repeats in found for one in repeats]
