"""Which points are on the front, beyond the noise of the times."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calibration.experiments.tradeoff.front import MARGIN, find_dominators


def front(accuracy: list[float], times: list[float], noise: float = 0.001) -> list[int]:
    """The points on the front; every time varies by `noise` on its own in each of 200 replicates."""
    rng = np.random.default_rng(0)
    ratios = np.array(times) * (1 + noise * rng.normal(size=(200, len(times))))
    return [k for k, others in enumerate(find_dominators(np.array(accuracy), ratios)) if not others]


def test_a_point_that_is_worse_in_both_is_dominated() -> None:
    """The fast one and the accurate one stay; the one that is slower than the first and no better goes."""
    assert front([0.5, 0.8, 0.5], [1.0, 2.0, 1.5]) == [0, 1]


def test_a_difference_within_the_noise_is_no_difference() -> None:
    """1 % faster with less accuracy is not on the front, 10 % faster is."""
    assert MARGIN == 0.02
    assert front([0.5, 0.8], [0.99, 1.0]) == [1]
    assert front([0.5, 0.8], [0.90, 1.0]) == [0, 1]


def test_a_noisy_advantage_does_not_count() -> None:
    """10 % faster in the median is no certain advantage where single replicates differ by 20 %."""
    assert front([0.5, 0.8], [0.90, 1.0], noise=0.2) == [1]


def test_a_slow_phase_that_hits_all_points_changes_nothing() -> None:
    """Points are compared within a replicate: a common factor cancels, however large it is."""
    rng = np.random.default_rng(1)
    common = rng.uniform(1, 5, size=(200, 1))
    found = find_dominators(np.array([0.5, 0.8]), common * np.array([[0.9, 1.0]]))
    assert found == [[], []]


def test_an_undefined_accuracy_is_never_on_the_front() -> None:
    """A point without accuracy is dominated by any point that has one, also by a slower one."""
    assert front([float("nan"), 0.1], [1.0, 1.001]) == [1]


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0.5, 5)), min_size=1, max_size=8))
def test_some_point_is_always_on_the_front(points: list[tuple[float, float]]) -> None:
    """Domination has no circles."""
    accuracy, times = zip(*points, strict=True)
    assert front(list(accuracy), list(times))
