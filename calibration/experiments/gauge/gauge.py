"""Gauge R&R of the score by analysis of variance: pieces and operators crossed, both random.

Ref: AIAG, Measurement Systems Analysis, 4th edition, chapter III, section B (ANOVA method): EV is repeatability, AV the
operators, INT operators x pieces, GRR all three, PV the pieces, TV everything; shares are of TV; ndc is 1.41 PV / GRR,
cut to a whole number. The interaction is pooled with the error where it is not significant.

Intervals are generalised confidence intervals: each mean square is divided by a chi-square variate over its degrees of
freedom, and the components are computed again (Hamada and Weerahandi, Journal of Quality Technology 32, 2000). They
hold for components and for ratios alike, and need no approximation of degrees of freedom.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.distributions import f_above, t_quantile, t_two_sided

__all__ = [
    "COMPONENTS",
    "AverageRange",
    "Component",
    "Drift",
    "Gauge",
    "SourceRow",
    "by_average_and_range",
    "drift",
    "gauge_by_anova",
    "k_factor",
]

F64 = NDArray[np.float64]

COMPONENTS: Final = ("EV", "AV", "INT", "GRR", "PV", "TV")

# Above this probability the interaction is pooled with the error: AIAG's table tests at 0.05; a larger level keeps an
# interaction that may be real, as ASTM E2782 advises.
POOLED_ABOVE: Final = 0.25
# sqrt(2), as AIAG rounds it.
NDC_FACTOR: Final = 1.41
DRAWS: Final = 100_000
_LARGE: Final = 1e12
# The intervals of one study are the same at every report.
_SEED: Final = 4


@dataclass(frozen=True)
class SourceRow:
    """One row of the table of variance. f, p: None where nothing is tested."""

    name: str
    ss: float
    df: int
    ms: float
    f: float | None = None
    p: float | None = None


@dataclass(frozen=True)
class Component:
    """One standard deviation with its interval, its share of TV as AIAG gives it (of the standard deviations, percent),
    and its share of the variance (percent). A share has no interval for TV itself."""

    name: str
    sd: float
    low: float
    high: float
    percent: float
    percent_low: float
    percent_high: float
    contribution: float


@dataclass(frozen=True)
class Gauge:
    """rows: the table of variance. is_pooled: the interaction is in the error. ndc: number of distinct categories, with
    the ends of its interval. confidence: of the intervals."""

    rows: tuple[SourceRow, ...]
    is_pooled: bool
    components: tuple[Component, ...]
    ndc: int
    ndc_low: int
    ndc_high: int
    confidence: float

    def component(self, name: str) -> Component:
        """Return the component of this name in `COMPONENTS`."""
        return next(one for one in self.components if one.name == name)


def gauge_by_anova(scores: F64, confidence: float = 0.95) -> Gauge:
    """scores: float64 (pieces, operators, repeats), at least two of each. Errors: ValueError for fewer, or for scores
    that are not finite or all equal."""
    _check(scores)
    rows = _table(scores)
    is_pooled = rows["interaction"].p is not None and rows["interaction"].p > POOLED_ABOVE
    error = _pool(rows) if is_pooled else rows["repeatability"]
    squares = {
        "piece": (rows["pieces"].ms, rows["pieces"].df),
        "operator": (rows["operators"].ms, rows["operators"].df),
        "interaction": (error.ms, error.df)
        if is_pooled
        else (rows["interaction"].ms, rows["interaction"].df),
        "error": (error.ms, error.df),
    }
    found = _components({name: np.array([ms]) for name, (ms, _) in squares.items()}, scores.shape)
    drawn = _components(_draw_squares(squares, is_pooled=is_pooled), scores.shape)
    tails = ((1 - confidence) / 2, (1 + confidence) / 2)
    components = tuple(_component(name, found, drawn, tails) for name in COMPONENTS)
    ndc = NDC_FACTOR * _ratio(found["PV"], found["GRR"])
    ndc_low, ndc_high = np.quantile(NDC_FACTOR * _ratio(drawn["PV"], drawn["GRR"]), tails)
    listed = _list_sources(rows, error if is_pooled else None, scores.shape)
    return Gauge(listed, is_pooled, components, _whole(ndc[0]), _whole(ndc_low), _whole(ndc_high), confidence)


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


def _table(scores: F64) -> dict[str, SourceRow]:
    """The table of variance with the interaction; operators and pieces are tested against it."""
    pieces, operators, repeats = scores.shape
    mean = scores.mean()
    of_piece, of_operator = scores.mean(axis=(1, 2)), scores.mean(axis=(0, 2))
    of_cell = scores.mean(axis=2)
    ss_piece = operators * repeats * float(((of_piece - mean) ** 2).sum())
    ss_operator = pieces * repeats * float(((of_operator - mean) ** 2).sum())
    inside = of_cell - of_piece[:, None] - of_operator[None, :] + mean
    ss_interaction = repeats * float((inside**2).sum())
    ss_error = float(((scores - of_cell[..., None]) ** 2).sum())
    df_interaction, df_error = (pieces - 1) * (operators - 1), pieces * operators * (repeats - 1)
    error = _row("repeatability", ss_error, df_error)
    interaction = _row("interaction", ss_interaction, df_interaction, error)
    return {
        "operators": _row("operators", ss_operator, operators - 1, interaction),
        "pieces": _row("pieces", ss_piece, pieces - 1, interaction),
        "interaction": interaction,
        "repeatability": error,
    }


def _row(name: str, ss: float, df: int, against: SourceRow | None = None) -> SourceRow:
    ms = ss / df
    if against is None:
        return SourceRow(name, ss, df, ms)
    f = ms / against.ms if against.ms > 0 else math.inf
    return SourceRow(name, ss, df, ms, f, f_above(f, df, against.df))


def _pool(rows: Mapping[str, SourceRow]) -> SourceRow:
    error, interaction = rows["repeatability"], rows["interaction"]
    return _row("repeatability with interaction", error.ss + interaction.ss, error.df + interaction.df)


def _list_sources(
    rows: Mapping[str, SourceRow], pooled: SourceRow | None, shape: tuple[int, ...]
) -> tuple[SourceRow, ...]:
    """List the sources as printed: after pooling, operators and pieces are tested against the pooled error."""
    listed = list(rows.values())
    if pooled is not None:
        tested = [_row(row.name, row.ss, row.df, pooled) for row in listed[:2]]
        listed = [*tested, *listed[2:], pooled]
    total = sum(row.ss for row in rows.values())
    df = math.prod(shape) - 1
    return (*listed, SourceRow("total", total, df, total / df))


def _components(squares: Mapping[str, F64], shape: tuple[int, ...]) -> dict[str, F64]:
    """Variances from mean squares, each float64 (n,); a negative estimate is 0, as AIAG has it."""
    pieces, operators, repeats = shape
    error, interaction = squares["error"], squares["interaction"]
    ev = error
    inter = np.maximum(0.0, (interaction - error) / repeats)
    av = np.maximum(0.0, (squares["operator"] - interaction) / (pieces * repeats))
    pv = np.maximum(0.0, (squares["piece"] - interaction) / (operators * repeats))
    grr = ev + av + inter
    return {"EV": ev, "AV": av, "INT": inter, "GRR": grr, "PV": pv, "TV": grr + pv}


def _draw_squares(squares: Mapping[str, tuple[float, int]], *, is_pooled: bool) -> dict[str, F64]:
    """Draw mean squares that the true variances may have."""
    rng = np.random.default_rng(_SEED)
    drawn = {name: ms * df / rng.chisquare(df, DRAWS) for name, (ms, df) in squares.items()}
    return {**drawn, "interaction": drawn["error"]} if is_pooled else drawn


def _component(
    name: str, found: Mapping[str, F64], drawn: Mapping[str, F64], tails: tuple[float, float]
) -> Component:
    low, high = np.sqrt(np.quantile(drawn[name], tails))
    percent = 100 * np.sqrt(_ratio_of_variance(found[name], found["TV"]))
    percent_low, percent_high = 100 * np.sqrt(
        np.quantile(_ratio_of_variance(drawn[name], drawn["TV"]), tails)
    )
    contribution = 100 * float(_ratio_of_variance(found[name], found["TV"])[0])
    sd = math.sqrt(float(found[name][0]))
    return Component(
        name,
        sd,
        float(low),
        float(high),
        float(percent[0]),
        float(percent_low),
        float(percent_high),
        contribution,
    )


def _ratio_of_variance(part: F64, whole: F64) -> F64:
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def _ratio(pv: F64, grr: F64) -> F64:
    """Return the ratio of the standard deviations; very large where nothing varies but the pieces."""
    return np.sqrt(np.divide(pv, grr, out=np.full_like(pv, _LARGE), where=grr > 0))


def _whole(ndc: float) -> int:
    """Cut to a whole number, at least 1 as AIAG asks; 9999 stands for any larger number."""
    return max(1, int(min(ndc, 9999.0)))


# The range of normal values beyond this many standard deviations adds less than 1e-15.
_REACH: Final = 9.0
_POINTS: Final = 601


@dataclass(frozen=True)
class AverageRange:
    """Standard deviations."""

    ev: float
    av: float
    grr: float
    pv: float
    tv: float
    ndc: int
    mean_range: float
    """The mean range over the cells."""
    upper_range: float
    """A cell with a larger range is looked at first."""
    cells_above: int

    def percent(self, name: str) -> float:
        """Return the share of TV in per cent, by the name of the field."""
        return 100 * float(getattr(self, name)) / self.tv if self.tv > 0 else 0.0


def by_average_and_range(scores: F64) -> AverageRange:
    """scores: float64 (pieces, operators, repeats), at least two of each, finite."""
    pieces, operators, repeats = scores.shape
    ranges = np.ptp(scores, axis=2)
    mean_range = float(ranges.mean())
    ev = mean_range * k_factor(repeats, None)
    between = float(np.ptp(scores.mean(axis=(0, 2)))) * k_factor(operators, 1)
    av = math.sqrt(max(0.0, between**2 - ev**2 / (pieces * repeats)))
    pv = float(np.ptp(scores.mean(axis=(1, 2)))) * k_factor(pieces, 1)
    grr = math.hypot(ev, av)
    d2, d3 = _range_of_normal(repeats)
    upper = mean_range * (1 + 3 * d3 / d2)  # D4
    return AverageRange(
        ev=ev,
        av=av,
        grr=grr,
        pv=pv,
        tv=math.hypot(grr, pv),
        ndc=max(1, int(min(1.41 * pv / grr, 9999.0))) if grr > 0 else 9999,
        mean_range=mean_range,
        upper_range=upper,
        cells_above=int((ranges > upper).sum()),
    )


def k_factor(n: int, groups: int | None) -> float:
    """1 / d2* of ranges of n values; groups None for many, as K1 takes it. Rounded to four places, as AIAG has it."""
    d2, d3 = _range_of_normal(n)
    d2_star = d2 if groups is None else math.sqrt(d2**2 + d3**2 / groups)
    return round(1 / d2_star, 4)


@cache
def _range_of_normal(n: int) -> tuple[float, float]:
    """d2 and d3: mean and standard deviation of the range of n standard normal values (Tippett, 1925)."""
    x = np.linspace(-_REACH, _REACH, _POINTS)
    below = np.array([0.5 * math.erfc(-one / math.sqrt(2)) for one in x])
    step = float(x[1] - x[0])
    mean = float((1 - below**n - (1 - below) ** n).sum()) * step
    low, high = below[:, None], below[None, :]
    inner = 1 - high**n - (1 - low) ** n + np.clip(high - low, 0, None) ** n
    square = 2 * float(np.triu(inner, 1).sum() + 0.5 * np.trace(inner)) * step**2
    return mean, math.sqrt(square - mean**2)


@dataclass(frozen=True)
class Drift:
    """Of the score from the first press to the last. low, high: 95 % interval of `total`."""

    total: float
    low: float
    high: float
    p: float
    """Probability of such a slope without a drift."""
    sd: float
    """Standard deviation of one score around the line."""
    presses: int

    @property
    def is_found(self) -> bool:
        return self.p < 0.05


def drift(scores: Sequence[float], cells: Sequence[Hashable], order: Sequence[int]) -> Drift | None:
    """scores, the cell (piece and operator) and the place in the order of each press. None where the order cannot be
    separated from the cells."""
    y, t = np.asarray(scores, np.float64), np.asarray(order, np.float64)
    inside_y, inside_t = _inside(y, cells), _inside(t, cells)
    spread = float(inside_t @ inside_t)
    df = len(y) - len(set(cells)) - 1
    if df < 1 or spread <= 0:
        return None
    slope = float(inside_t @ inside_y) / spread
    rest = inside_y - slope * inside_t
    sd = math.sqrt(float(rest @ rest) / df)
    error, length = sd / math.sqrt(spread), float(np.ptp(t))
    half = t_quantile(0.975, df) * error * length
    p = t_two_sided(slope / error, df) if error > 0 else float(slope == 0)
    return Drift(slope * length, slope * length - half, slope * length + half, p, sd, len(y))


def _inside(values: F64, cells: Sequence[Hashable]) -> F64:
    """Return the values without the mean of their cell."""
    number = {cell: n for n, cell in enumerate(dict.fromkeys(cells))}
    index = np.array([number[cell] for cell in cells])
    means = np.bincount(index, values) / np.bincount(index)
    return np.asarray(values - means[index])
