"""Greedy k-centre: the rows that the lazy search skips change no pick."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugins.detectors.common import coreset
from plugins.detectors.common.coreset import k_centre


def greedy(points: np.ndarray, count: int, start: int) -> tuple[list[int], float]:
    """The picks by all distances, and how far the farthest row is from them."""
    picks, distance = [start], np.square(points - points[start]).sum(axis=1)
    while len(picks) < min(count, len(points)) and distance.max() > 0:
        picks.append(int(distance.argmax()))
        distance = np.minimum(distance, np.square(points - points[picks[-1]]).sum(axis=1))
    return picks, float(np.sqrt(distance.max()))


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([(256, 0.9), (2, 0.5), (1, 0.99)]),
    st.integers(1, 40),
    st.integers(1, 5),
    st.integers(1, 40),
    st.integers(0, 2**32 - 1),
)
def test_lazy_and_full_are_the_same(sizes: tuple[int, float], n: int, c: int, count: int, seed: int) -> None:
    """Integers with many ties: the same rows in the same order as with all distances, the lowest first, also where few
    rows are updated together and the level falls in large or small steps (`sizes`)."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 4, (n, c)).astype(np.float32)
    start = int(rng.integers(n))
    with mock.patch.object(coreset, "BATCH", sizes[0]), mock.patch.object(coreset, "STEP", sizes[1]):
        found = k_centre(points, count, start)
    picks, radius = greedy(points, count, start)
    assert found.rows.tolist() == picks
    assert found.radius == pytest.approx(radius)


def test_any_copy_of_a_repeated_row_may_be_picked_and_no_other_row() -> None:
    """Fractions, every row twice: the picked rows are those of all distances, in their order."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(400, 8)).repeat(2, axis=0)
    found = k_centre(points, 60, 5)
    picks, radius = greedy(points, 60, 5)

    np.testing.assert_array_equal(points[found.rows], points[picks])
    assert found.radius == pytest.approx(radius)


def test_the_search_ends_where_every_row_equals_a_pick() -> None:
    """Seven rows of fractions far from zero, many times each: rounding of the product is no distance."""
    rng = np.random.default_rng(0)
    points = (rng.normal(size=(7, 64)) * 100)[rng.integers(0, 7, 300)]
    found = k_centre(points, 20, 0)

    assert len(found.rows) == len(np.unique(points, axis=0)) == 7
    assert found.radius == 0
