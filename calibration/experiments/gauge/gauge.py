"""Gauge R&R of the score by analysis of variance, pieces and operators crossed, both random; and agreement of verdicts.

Ref: AIAG, Measurement Systems Analysis, 4th edition, chapter III, section B (ANOVA method): EV is repeatability, AV the
operators, INT operators x pieces, GRR all three, PV the pieces, TV everything; shares are of TV; ndc is 1.41 PV / GRR,
cut to a whole number. The interaction is pooled with the error where it is not significant.

Intervals are generalised confidence intervals: each mean square is divided by a chi-square variate over its degrees of
freedom, and the components are computed again (Hamada and Weerahandi, Journal of Quality Technology 32, 2000). They
hold for components and for ratios alike, and need no approximation of degrees of freedom.

Verdicts agree: of an operator with himself, between operators, and with what is known of the pieces. Ref: AIAG, ibid.,
section C (attribute study, hypothesis test analyses with kappa, effectiveness); Cohen, Educational and Psychological
Measurement 20 (1960); Fleiss, Psychological Bulletin 76 (1971). Standard errors of a kappa against chance: Fleiss,
Cohen and Everitt, Psychological Bulletin 72 (1969). `unsure` is a verdict of its own. It is not a pass: on a bad piece
it is no miss, on a good one it is a false alarm, and it is never a correct decision.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from edge.core.arrays import F64, Mask
from edge.core.binomial import rate_limits

__all__ = [
    "Drift",
    "Gauge",
    "Kappa",
    "Share",
    "Shares",
    "Words",
    "cohen_kappa",
    "count_shares",
    "drift",
    "fleiss_kappa",
    "gauge_by_anova",
]

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


def _share(flags: Mask) -> Share:
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


# Above this probability the interaction is pooled with the error: AIAG's table tests at 0.05; a larger level keeps an
# interaction that may be real, as ASTM E2782 advises.
POOLED_ABOVE: Final = 0.25
# sqrt(2), as AIAG rounds it.
NDC_FACTOR: Final = 1.41
CONFIDENCE: Final = 0.95
DRAWS: Final = 100_000
_LARGE: Final = 1e12
# The intervals of one study are the same at every report.
_SEED: Final = 4


class Source(NamedTuple):
    """One row of the table of variance. f, p: None where nothing is tested."""

    name: str
    ss: float
    df: int
    ms: float
    f: float | None = None
    p: float | None = None


class Estimate(NamedTuple):
    """A value with the ends of its interval."""

    value: float
    low: float
    high: float


class Gauge(NamedTuple):
    """The table of variance, and by component (EV, AV, INT, GRR, PV, TV) the standard deviation and its share of TV."""

    sources: tuple[Source, ...]
    is_pooled: bool
    """The interaction is in the error."""
    sd: dict[str, Estimate]
    percent: dict[str, Estimate]
    """As AIAG gives it: of the standard deviations."""
    ndc: Estimate
    """The number of distinct categories."""


def gauge_by_anova(scores: F64) -> Gauge:
    """Separate the variance of scores, float64 (pieces, operators, repeats), at least two of each.

    Errors: ValueError for fewer, or for scores that are not finite or all equal.
    """
    _check(scores)
    sources = _sources(scores)
    interaction, error = sources["interaction"], sources["repeatability"]
    pooled = None
    if interaction.p is not None and interaction.p > POOLED_ABOVE:
        pooled = _source(
            "repeatability with interaction", error.ss + interaction.ss, error.df + interaction.df
        )
    variances = _variances(sources, pooled, scores.shape)
    pv, grr = variances["PV"], variances["GRR"]
    ratio = np.sqrt(np.divide(pv, grr, out=np.full_like(pv, _LARGE), where=grr > 0))
    # AIAG asks for at least 1; 9999 stands for any larger number.
    ndc = (float(max(1, int(min(found, 9999.0)))) for found in _estimate(NDC_FACTOR * ratio))
    return Gauge(
        _list_sources(sources, pooled, scores.size - 1),
        pooled is not None,
        {name: _estimate(np.sqrt(found)) for name, found in variances.items()},
        {name: _estimate(100 * np.sqrt(found / variances["TV"])) for name, found in variances.items()},
        Estimate(*ndc),
    )


def _check(scores: F64) -> None:
    if scores.ndim != 3 or min(scores.shape) < 2:
        raise ValueError(
            "a gauge study has at least 2 pieces, 2 operators and 2 repeats, found "
            f"{' x '.join(map(str, scores.shape))}"
        )
    if not np.isfinite(scores).all():
        raise ValueError("a score is missing or not finite; press that piece again")
    if float(np.ptp(scores)) == 0.0:
        raise ValueError(
            f"all scores are {scores.flat[0]:g}, so nothing varies; check that the pieces were changed"
        )


def _sources(scores: F64) -> dict[str, Source]:
    """Return the sources of variance; operators and pieces are tested against the interaction."""
    pieces, operators, repeats = scores.shape
    mean, of_cell = scores.mean(), scores.mean(axis=2)
    of_piece, of_operator = scores.mean(axis=(1, 2)), scores.mean(axis=(0, 2))
    inside = of_cell - of_piece[:, None] - of_operator + mean
    error = _source(
        "repeatability", ((scores - of_cell[..., None]) ** 2).sum(), pieces * operators * (repeats - 1)
    )
    both = _source("interaction", repeats * (inside**2).sum(), (pieces - 1) * (operators - 1), error)
    ss_operator = pieces * repeats * ((of_operator - mean) ** 2).sum()
    ss_piece = operators * repeats * ((of_piece - mean) ** 2).sum()
    factors = (
        _source("operators", ss_operator, operators - 1, both),
        _source("pieces", ss_piece, pieces - 1, both),
    )
    return {source.name: source for source in (*factors, both, error)}


def _source(name: str, ss: float, df: int, against: Source | None = None) -> Source:
    ms = float(ss) / df
    if against is None:
        return Source(name, float(ss), df, ms)
    f = ms / against.ms if against.ms > 0 else math.inf
    return Source(name, float(ss), df, ms, f, float(stats.f.sf(f, df, against.df)))


def _list_sources(sources: Mapping[str, Source], pooled: Source | None, df: int) -> tuple[Source, ...]:
    """List the sources as printed: after pooling, operators and pieces are tested against the pooled error."""
    total = _source("total", sum(source.ss for source in sources.values()), df)
    if pooled is None:
        return (*sources.values(), total)
    operators, pieces, *rest = sources.values()
    tested = (_source(source.name, source.ss, source.df, pooled) for source in (operators, pieces))
    return (*tested, *rest, pooled, total)


def _variances(
    sources: Mapping[str, Source], pooled: Source | None, shape: tuple[int, ...]
) -> dict[str, F64]:
    """Compute the variance of each component, float64 (1 + DRAWS,): its estimate, then values that it may have.

    A negative estimate is 0, as AIAG has it.
    """
    pieces, operators, repeats = shape
    rng = np.random.default_rng(_SEED)
    drawn = (
        np.append(source.ms, source.ms * source.df / rng.chisquare(source.df, DRAWS))
        for source in (
            sources["pieces"],
            sources["operators"],
            pooled or sources["interaction"],
            pooled or sources["repeatability"],
        )
    )
    piece, operator, interaction, error = drawn
    if pooled is not None:
        interaction = error
    both = np.maximum(0.0, (interaction - error) / repeats)
    av = np.maximum(0.0, (operator - interaction) / (pieces * repeats))
    pv = np.maximum(0.0, (piece - interaction) / (operators * repeats))
    grr = error + av + both
    return {"EV": error, "AV": av, "INT": both, "GRR": grr, "PV": pv, "TV": grr + pv}


def _estimate(values: F64) -> Estimate:
    low, high = np.quantile(values[1:], ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)).tolist()
    return Estimate(float(values[0]), low, high)


class Drift(NamedTuple):
    """How the score changed from the first press to the last."""

    total: Estimate
    p: float
    """Probability of such a slope without a drift."""
    sd: float
    """Standard deviation of one score around the line."""


def drift(scores: Sequence[float], cells: Sequence[Hashable]) -> Drift | None:
    """Fit a line through scores in the order of time, each without the mean of its cell (piece and operator).

    None where the order cannot be separated from the cells.
    """
    number = {cell: n for n, cell in enumerate(dict.fromkeys(cells))}
    index = np.array([number[cell] for cell in cells])
    y, t = (
        values - (np.bincount(index, values) / np.bincount(index))[index]
        for values in (np.asarray(scores, np.float64), np.arange(float(len(index))))
    )
    spread, df = float(t @ t), len(y) - len(number) - 1
    if df < 1 or spread <= 0:
        return None
    slope, length = float(t @ y) / spread, len(y) - 1
    rest = y - slope * t
    sd = math.sqrt(float(rest @ rest) / df)
    error = sd / math.sqrt(spread)
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, df)) * error * length
    p = 2 * float(stats.t.sf(abs(slope) / error, df)) if error > 0 else float(slope == 0)
    return Drift(Estimate(slope * length, slope * length - half, slope * length + half), p, sd)
