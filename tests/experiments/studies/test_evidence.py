"""Which method is better: decided where the interval of the paired differences is above zero, else undecided."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from calibration.experiments.harness.evidence import (
    MIN_DRAWS,
    Sample,
    are_drawn,
    mean_interval,
    rank,
    summarise,
)


def drawn(values: dict[tuple[str, int], float], *, are_drawn: bool = True) -> Sample:
    return {key: (value, are_drawn) for key, value in values.items()}


def values(
    level: float, spread: float, *, parts: int = 3, seeds: int = 10, seed: int = 0, are_drawn: bool = True
) -> Sample:
    """Values around a level; each part has an offset of its own, which all methods share."""
    rng = np.random.default_rng(seed)
    keys = [(f"PZ{part}", k) for part in range(parts) for k in range(seeds)]
    found = {(part, k): level + 0.1 * int(part[2:]) + spread * rng.normal() for part, k in keys}
    return drawn(found, are_drawn=are_drawn)


def test_the_interval_has_the_width_of_the_standard_error() -> None:
    """Of one part with many seeds: 1.96 standard errors to each side, within a tenth."""
    normal = np.random.default_rng(3).normal(size=400)
    mean = summarise(drawn({("a", k): float(v) for k, v in enumerate(normal)}))

    assert (mean.high - mean.low) / 2 == pytest.approx(1.96 * normal.std() / 20, rel=0.1)


def test_the_better_method_is_the_answer_and_turning_the_numbers_turns_it() -> None:
    """0.05 apart with a spread of 0.01, also where parts differ by more than methods do."""
    good, bad = values(0.55, 0.01, seed=1), values(0.50, 0.01, seed=2)

    assert rank({"a": good, "b": bad}).best == "a"
    assert rank({"a": bad, "b": good}).best == "b"
    assert rank({"a": good, "b": bad}, higher_is_better=False).best == "b"


def test_methods_that_overlap_are_undecided() -> None:
    """The answer names both, and the interval of the advantage."""
    found = rank({"a": values(0.5, 0.05, seed=1), "b": values(0.5, 0.05, seed=2)})

    assert found.best is None
    assert len(found.rivals) == 1
    assert "the advantage of" in found.why


def test_an_advantage_on_one_part_and_a_loss_on_another_is_undecided() -> None:
    """However small the dispersion over seeds is."""
    a = {("PZ1", k): 0.9 + 0.001 * k for k in range(10)} | {("PZ2", k): 0.3 + 0.001 * k for k in range(10)}
    b = {("PZ1", k): 0.5 + 0.001 * k for k in range(10)} | {("PZ2", k): 0.6 + 0.001 * k for k in range(10)}
    first = drawn({p: v for p, v in a.items() if p[0] == "PZ1"})

    assert rank({"a": drawn(a), "b": drawn(b)}).best is None
    assert rank({"a": first, "b": drawn(b)}).best == "a"


def test_two_parts_decide_nothing() -> None:
    """By chance both are on one side in half of all cases, however many seeds each has."""
    good, bad = values(0.9, 0.001, parts=2, seed=1), values(0.1, 0.001, parts=2, seed=2)
    found = rank({"a": good, "b": bad})

    assert found.best is None
    assert "with 2 parts there is no interval, at least 3 are needed" in found.why


def test_too_few_seeds_are_undecided() -> None:
    """On one part; the sentence says how many are needed."""
    seeds = MIN_DRAWS - 1
    found = rank({name: values(v, 0.0, parts=1, seeds=seeds) for name, v in {"a": 0.9, "b": 0.1}.items()})

    assert found.best is None
    assert f"at least {MIN_DRAWS} are needed" in found.why


def test_seeds_that_learn_the_same_presses_decide_nothing() -> None:
    """Ten times the same bank is one bank; if one of two methods learns other presses, the difference is drawn."""
    good, bad = (values(level, 0.001, parts=1, seed=1, are_drawn=False) for level in (0.9, 0.1))
    found = rank({"a": good, "b": bad})

    assert found.best is None
    assert found.means["a"].draws == 1
    assert "all seeds of this part learn the same presses" in found.why
    assert rank({"a": values(0.9, 0.001, parts=1, seed=2), "b": bad}).best == "a"


def test_a_method_alone_and_methods_on_other_parts_are_undecided() -> None:
    a, b = values(0.9, 0.01), drawn({("other", k): 0.1 for k in range(10)})

    assert "alone" in rank({"a": a}).why
    assert "no part and seed in common" in rank({"a": a, "b": b}).why


@pytest.mark.parametrize("draws", [3, 5, 10])
def test_an_interval_holds_the_mean_in_95_of_100_cases(draws: int) -> None:
    """Of 4,000 simulated sets of few values; the percentiles of a bootstrap hold it in 74, 84 and 90 %."""
    sets = np.random.default_rng(draws).normal(size=(4000, draws))
    held = np.mean([low <= 0 <= high for low, high in map(mean_interval, sets)])

    assert held == pytest.approx(0.95, abs=0.012)


def test_fewer_draws_have_no_interval() -> None:
    """Nothing is printed that two values cannot show."""
    assert all(math.isnan(end) for end in mean_interval(np.arange(MIN_DRAWS - 1.0)))
    assert mean_interval(np.full(MIN_DRAWS, 0.5)) == (0.5, 0.5)


@pytest.mark.parametrize("span", [(0.0, 1.0), (-1.0, 1.0), (0.0, math.inf)])
def test_an_interval_stays_within_the_range_of_its_measure(span: tuple[float, float]) -> None:
    """Three parts, of which one is lost: Student's t alone gives -0.68 to 1.85. Far from the ends both are the same."""
    low, high = mean_interval(np.array([0.0, 0.86, 0.9]), span)
    assert span[0] < low < 0.587 < high < span[1]

    close = np.array([0.50, 0.51, 0.52])
    assert mean_interval(close, span) == pytest.approx(mean_interval(close), abs=2e-3)
    assert mean_interval(np.zeros(3), span) == (0.0, 0.0)
    assert mean_interval(np.array([0.0, 0.0, 1e-9]), span)[1] <= span[1]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"presses": 22, "pool": 110, "fraction": 0.2}, True),
        ({"presses": 110, "pool": 110, "fraction": 1.0}, False),
        ({"presses": 8, "pool": 110, "shots": 8, "fraction": math.nan}, True),
        ({"presses": 12, "pool": 110, "most_presses": 12, "fraction": 0.6}, False),
        (
            {
                "presses": 12,
                "pool": 110,
                "most_presses": 12,
                "fraction": 0.6,
                "target_fraction": math.nan,
                "bad": math.nan,
            },
            False,
        ),
        ({"presses": 11, "pool": 110, "most_presses": 24, "fraction": 0.1}, True),
        ({"presses": 116, "pool": 110, "fraction": 1.0, "target_fraction": 0.05}, True),
        ({"presses": 110, "pool": 110, "fraction": 1.0, "target_fraction": 0.0}, False),
        ({"presses": 66, "fraction": 0.6, "target_fraction": 0.0}, True),
        ({"presses": 110, "fraction": 1.0, "bad": 0.1}, True),
        ({"presses": 110, "fraction": 1.0, "bad": 0.0}, False),
    ],
)
def test_a_seed_draws_presses_unless_all_are_learnt(row: dict[str, Any], expected: bool) -> None:
    """Of every study: the pool, its cap, the second position and the damaged presses."""
    assert are_drawn(pd.DataFrame([row])).tolist() == [expected]
