"""What rows of presses show: means over draws with their intervals, what an effect changes, and which method is best.

Methods and conditions are compared by paired differences, on the same parts and seeds. The 95 % interval of a mean is
over the means of the parts, or over the draws of presses where there is one part, which says nothing about others.
Seeds that learn the same presses are one draw. An effect has a direction if its interval is beside zero; a method is
the best if the interval of its advantage over each other method is above zero.
"""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from calibration.experiments.harness.published import paper_medians
from edge.core.arrays import F64

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COMPARED",
    "MIN_DRAWS",
    "STABLE_WITHIN",
    "Mean",
    "Sample",
    "Standing",
    "are_drawn",
    "compare_directions",
    "count_agreements",
    "direction",
    "effects",
    "mean_interval",
    "rank",
    "sample",
    "spread_measures",
    "stable_from",
    "subtract",
    "summarise",
    "write_condition",
]

COMPARED: Mapping[str, str] = {"pixel_auroc": "AUROC", "auprc": "AUPRC", "aupro_001": "AU-PRO@0.01"}
"""The measures of the paper's Tables 2 and 3, with their headings."""

MIN_DRAWS = 3
"""With fewer values there is no interval: of two it would be nine times as wide as the two are apart."""

STABLE_WITHIN = 0.01
"""How far the mean over seeds may be from that of all presses, for every larger fraction, part and measure."""

Direction = Literal["up", "down", "undecided"]

Span = tuple[float, float]
ANY: Span = (-math.inf, math.inf)


def mean_interval(values: F64, span: Span = ANY) -> Span:
    """Return the 95 % interval of the mean of values (n,), by Student's t; nan where there are too few.

    span: the range of the values. With both ends, the interval is computed for the logit of the mean, with the lowest
    alone for its logarithm, each with the slope at the mean; so both ends are in the range. With three to ten values
    the percentiles of a bootstrap are too narrow: of ten values they held the true mean in 90 % of simulated cases, of
    five in 83 %, of three in 75 %.
    """
    from scipy import stats

    lowest, highest = span
    if len(values) < MIN_DRAWS:
        return math.nan, math.nan
    mean, error = float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))
    half = float(stats.t.ppf(0.975, len(values) - 1)) * error
    if math.isinf(lowest):
        return mean - half, mean + half
    below, above = mean - lowest, highest - mean
    if min(below, above) <= 0:
        return mean, mean  # every value is at this end of the range
    factor = math.exp(min(half * (1 / below + 1 / above), 700.0))
    share = below / (highest - lowest)
    low, high = (lowest + below * f / (1 + share * (f - 1)) for f in (1 / factor, factor))
    return low, min(high, highest)


def are_drawn(rows: "pd.DataFrame") -> "pd.Series[bool]":
    """Return for each row whether its seed decided which presses its bank learnt.

    Where a bank learns all presses of the pool, other seeds are no other draws: they change at most what the method
    itself draws.
    """
    names = ["bad", "target_fraction", "pool", "most_presses", "presses", "fraction"]
    given = rows.reindex(columns=names).astype(float)
    pool = given[["pool", "most_presses"]].min(axis=1)
    is_part = (given["presses"] < pool).where(
        pool.notna() & given["target_fraction"].isna(), ~(given["fraction"] >= 1)
    )
    return (given["bad"] > 0) | (given["target_fraction"] > 0) | is_part


Sample = Mapping[tuple[str, int], tuple[float, bool]]
"""By part and seed a value of one method, and whether presses were drawn for it."""


def sample(rows: "pd.DataFrame", measure: str) -> Sample:
    """Return the values of a measure. rows: of one method, in which each part and seed comes once."""
    if "drawn" not in rows:  # as `by_setup` adds it, once for all
        rows = rows.assign(drawn=are_drawn(rows))
    known = rows[["part", "seed", measure, "drawn"]].dropna()
    return {(part, seed): (float(value), drawn) for part, seed, value, drawn in known.to_numpy()}


def subtract(first: Sample, second: Sample) -> Sample:
    """Return the differences on the parts and seeds of both samples; a draw of either is a draw of the difference."""
    both = {key: (first[key], second[key]) for key in first if key in second}
    return {key: (one[0] - other[0], one[1] or other[1]) for key, (one, other) in both.items()}


@dataclass(frozen=True)
class Mean:
    """A mean and its 95 % interval, nan where there is none."""

    value: float
    low: float
    high: float
    parts: int
    draws: int
    """The least number of draws on a part."""

    @property
    def has_interval(self) -> bool:
        return math.isfinite(self.low)


def summarise(values: Sample, span: Span = ANY) -> Mean:
    """Return the mean over parts of the means over seeds, with its interval. span: the range of the values."""
    parts: dict[str, list[tuple[float, bool]]] = {}
    for (part, _), seed_value in sorted(values.items()):
        parts.setdefault(part, []).append(seed_value)
    arrays = [np.array([value for value, _ in ones]) for ones in parts.values()]
    draws = min(len(ones) if any(drawn for _, drawn in ones) else 1 for ones in parts.values())
    centres = np.array([array.mean() for array in arrays])
    few = arrays[0][:draws] if len(arrays) == 1 else centres
    return Mean(float(centres.mean()), *mean_interval(few, span), len(arrays), draws)


def direction(difference: Sample) -> Direction:
    """Return where a difference points; `undecided` where it has no interval, or one that includes zero."""
    mean = summarise(difference)
    if not mean.has_interval or mean.low <= 0 <= mean.high:
        return "undecided"
    return "up" if mean.value > 0 else "down"


def compare_directions(ours: Direction, before: float, after: float) -> tuple[Direction, str]:
    """Return the direction of the paper's medians, and whether ours agrees, differs or is undecided."""
    paper: Direction = "undecided" if before == after else "up" if after > before else "down"
    if "undecided" in (ours, paper):
        return paper, "undecided"
    return paper, "agree" if ours == paper else "differ"


def count_agreements(agreements: Iterable[str | None]) -> str:
    """Write `7 agree, 2 differ, 3 undecided`; what is not in the paper counts as nothing."""
    every = list(agreements)
    return ", ".join(f"{every.count(name)} {name}" for name in ("agree", "differ", "undecided"))


def write_condition(value: Hashable) -> str:
    """Write a condition as the paper's data do."""
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def effects(
    rows: "pd.DataFrame",
    condition: str,
    before: Any,
    after: Any,
    names: Mapping[str, str] = {},
    measures: Sequence[str] = tuple(COMPARED),
) -> "pd.DataFrame":
    """Return how measures change between two values of a column, for every method and part, here and in the paper.

    rows: of one study and setup. names: what the paper's data call our conditions, where it is another word.
    """
    import pandas as pd

    lines = []
    for (study, method, part), own in rows.groupby(["study", "method", "part"]):
        old, new = (own[own[condition] == value] for value in (before, after))
        for measure in measures:
            change = subtract(sample(new, measure), sample(old, measure))
            if not change:
                continue
            ours, paper, agreement = direction(change), "-", "-"
            known = paper_medians(study).get((method, part, measure), {})
            words = [names.get(text, text) for text in map(write_condition, (before, after))]
            if known.keys() >= set(words):
                paper, agreement = compare_directions(ours, *(known[word] for word in words))
            mean = f"{summarise(change).value:+.4f}"
            lines.append([method, part, COMPARED.get(measure, measure), mean, ours, paper, agreement])
    heading = ["method", "part", "measure", "mean difference", "here", "paper", "direction"]
    return pd.DataFrame(lines, columns=heading)


def spread_measures(found: "pd.DataFrame") -> "pd.DataFrame":
    """Return effects with a row for each method and part: `+0.0154 up (down)`, in brackets the paper's direction."""
    paper = found["paper"].map(lambda way: "" if way == "-" else f" ({way})")
    texts = found.assign(text=found["mean difference"] + " " + found["here"] + paper)
    spread = texts.pivot_table(
        "text", ["part", "method"], "measure", aggfunc="first", fill_value="-", sort=False
    )
    return spread.reset_index()[["method", "part", *spread.columns]]


def stable_from(rows: "pd.DataFrame") -> float | None:
    """Return the smallest fraction from which on every mean is near that of the largest fraction; None without rows.

    rows: of one method, mode, backbone and split. The rule holds for all parts and the three measures of the paper
    together, so that a method has one value, as in the paper.
    """
    curves = rows.reindex(columns=["part", "position", "fraction", *COMPARED])
    long = curves.melt(["part", "position", "fraction"], var_name="measure").dropna()
    means = long.groupby(["part", "position", "measure", "fraction"])["value"].mean()
    flat = [_flat_from(curve.droplevel([0, 1, 2])) for _, curve in means.groupby(level=[0, 1, 2])]
    return max(flat, default=None)


def _flat_from(curve: "pd.Series[float]") -> float:
    """Return the first fraction of the flat end of one curve: all means there are near the last one."""
    far = curve.index[(curve - curve.iloc[-1]).abs() > STABLE_WITHIN]
    return float(min(curve.index if far.empty else curve.index[curve.index > far.max()]))


@dataclass(frozen=True)
class Standing:
    """Methods in order of their mean, the best first."""

    means: Mapping[str, Mean]
    best: str | None
    """The method that is better than all others, None if the values do not decide; then `why` says why not."""
    rivals: tuple[str, ...] = ()
    """Methods that cannot be distinguished from the first."""
    why: str = ""


def rank(samples: Mapping[str, Sample], *, higher_is_better: bool = True, span: Span = ANY) -> Standing:
    """Return the standing of methods by their samples. span: of the measure. Errors: ValueError without a method."""
    sign = 1 if higher_is_better else -1
    width = span[1] - span[0]
    means = {method: summarise(one, span) for method, one in samples.items()}
    means = dict(sorted(means.items(), key=lambda pair: -sign * pair[1].value))
    first, *others = means
    if not others:
        return Standing(
            means, None, (), f"the rows have {first} alone, so there is nothing to compare it with"
        )
    spans = {}
    for other in others:
        difference = subtract(samples[first], samples[other])
        if not difference:
            return Standing(means, None, (other,), f"{first} and {other} have no part and seed in common")
        advantage = summarise(difference, (-width, width))
        if not advantage.has_interval:
            return Standing(means, None, tuple(others), _say_too_few(advantage, difference))
        low, high = sorted((sign * advantage.low, sign * advantage.high))
        if low <= 0:
            spans[other] = f"{low:+.3f} to {high:+.3f} over {other}"
    if spans:
        return Standing(means, None, tuple(spans), f"the advantage of {first} is {'; '.join(spans.values())}")
    return Standing(means, first)


def _say_too_few(advantage: Mean, difference: Sample) -> str:
    if advantage.parts > 1:
        return f"with {advantage.parts} parts there is no interval, at least {MIN_DRAWS} are needed"
    if not any(drawn for _, drawn in difference.values()):
        return (
            "all seeds of this part learn the same presses, so nothing shows what other presses would give; more parts "
            "or fewer presses of the pool would"
        )
    draws = advantage.draws
    return f"with {draws} seed{'s' * (draws > 1)} there is no interval, at least {MIN_DRAWS} are needed"
