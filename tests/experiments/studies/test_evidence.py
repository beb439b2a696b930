"""Which method is better: decided where the interval of the paired differences is above zero, else undecided."""

import numpy as np
import pytest

from calibration.experiments.harness.evidence import Sample, ranking, summarised
from calibration.experiments.harness.intervals import MIN_DRAWS


def values(level: float, spread: float, *, parts: int = 3, seeds: int = 10, seed: int = 0) -> Sample:
    """Values around a level; each part has an offset of its own, which all methods share."""
    rng = np.random.default_rng(seed)
    return Sample(
        {
            (f"PZ{part}", k): level + 0.1 * part + spread * rng.normal()
            for part in range(parts)
            for k in range(seeds)
        }
    )


def test_the_mean_and_its_interval() -> None:
    """The mean of parts of the mean of seeds; without spread the interval is the mean."""
    mean = summarised(Sample({("a", 0): 1.0, ("a", 1): 1.0, ("b", 0): 1.0, ("c", 0): 1.0}))

    assert (mean.value, mean.low, mean.high, mean.parts, mean.draws) == (1.0, 1.0, 1.0, 3, 1)


def test_the_interval_has_the_width_of_the_standard_error() -> None:
    """Of one part with many seeds: 1.96 standard errors to each side, within a tenth."""
    drawn = np.random.default_rng(3).normal(size=400)
    mean = summarised(Sample({("a", k): float(v) for k, v in enumerate(drawn)}))

    assert (mean.high - mean.low) / 2 == pytest.approx(1.96 * drawn.std() / 20, rel=0.1)


def test_the_better_method_is_the_answer_and_turning_the_numbers_turns_it() -> None:
    """0.05 apart with a spread of 0.01, also where parts differ by more than methods do."""
    good, bad = values(0.55, 0.01, seed=1), values(0.50, 0.01, seed=2)

    assert ranking({"a": good, "b": bad}).best == "a"
    assert ranking({"a": bad, "b": good}).best == "b"
    assert ranking({"a": good, "b": bad}, higher_is_better=False).best == "b"


def test_methods_that_overlap_are_undecided() -> None:
    """The answer names both, and the interval of the advantage."""
    found = ranking({"a": values(0.5, 0.05, seed=1), "b": values(0.5, 0.05, seed=2)})

    assert found.best is None
    assert len(found.rivals) == 1
    assert "the advantage of" in found.why


def test_an_advantage_on_one_part_and_a_loss_on_another_is_undecided() -> None:
    """However small the dispersion over seeds is."""
    a = {("PZ1", k): 0.9 + 0.001 * k for k in range(10)} | {("PZ2", k): 0.3 + 0.001 * k for k in range(10)}
    b = {("PZ1", k): 0.5 + 0.001 * k for k in range(10)} | {("PZ2", k): 0.6 + 0.001 * k for k in range(10)}
    first = Sample({p: v for p, v in a.items() if p[0] == "PZ1"})

    assert ranking({"a": Sample(a), "b": Sample(b)}).best is None
    assert ranking({"a": first, "b": Sample(b)}).best == "a"


def test_two_parts_decide_nothing() -> None:
    """By chance both are on one side in half of all cases, however many seeds each has."""
    good, bad = values(0.9, 0.001, parts=2, seed=1), values(0.1, 0.001, parts=2, seed=2)
    found = ranking({"a": good, "b": bad})

    assert found.best is None
    assert "with 2 parts there is no interval, at least 3 are needed" in found.why


def test_too_few_seeds_are_undecided() -> None:
    """On one part; the sentence says how many are needed."""
    seeds = MIN_DRAWS - 1
    found = ranking({name: values(v, 0.0, parts=1, seeds=seeds) for name, v in {"a": 0.9, "b": 0.1}.items()})

    assert found.best is None
    assert f"at least {MIN_DRAWS} are needed" in found.why


def test_seeds_that_learn_the_same_presses_decide_nothing() -> None:
    """Ten times the same bank is one bank; if one of two methods learns other presses, the difference is drawn."""
    good, bad = values(0.9, 0.001, parts=1, seed=1), values(0.1, 0.001, parts=1, seed=2)
    same = {name: Sample(each.values, frozenset({"PZ0"})) for name, each in {"a": good, "b": bad}.items()}
    found = ranking(same)

    assert found.best is None
    assert found.means["a"].draws == 1
    assert "all seeds of this part learn the same presses" in found.why
    assert ranking({"a": good, "b": same["b"]}).best == "a"


def test_a_method_alone_and_methods_on_other_parts_are_undecided() -> None:
    """There is nothing to compare with."""
    a, b = values(0.9, 0.01), Sample({("other", k): 0.1 for k in range(10)})

    assert "alone" in ranking({"a": a}).why
    assert "no part and seed in common" in ranking({"a": a, "b": b}).why
