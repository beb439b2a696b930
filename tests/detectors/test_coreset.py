"""Greedy k-centre: the rows that the lazy search skips change no pick."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugins.detectors.common import coreset
from plugins.detectors.common.coreset import greedy_from_distances, k_centre


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([(256, 32), (3, 2), (1, 1)]),
    st.integers(1, 40),
    st.integers(1, 5),
    st.integers(1, 40),
    st.integers(0, 2**32 - 1),
)
def test_the_lazy_coreset_is_the_full_one(
    sizes: tuple[int, int], n: int, c: int, count: int, seed: int
) -> None:
    """Integers with many ties: the same rows in the same order as with all distances, the lowest first, also
    where the pool and the batch (`sizes`) hold few of the rows.
    """
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 4, (n, c)).astype(np.float32)
    start = int(rng.integers(n))
    with mock.patch.object(coreset, "POOL", sizes[0]), mock.patch.object(coreset, "BATCH", sizes[1]):
        found = k_centre(points, count, start)
    picks = [start]
    distance = np.square(points - points[start]).sum(axis=1)
    while len(picks) < min(count, n) and distance.max() > 0:
        picks.append(int(distance.argmax()))
        distance = np.minimum(distance, np.square(points - points[picks[-1]]).sum(axis=1))
    assert found.rows.tolist() == picks
    assert found.radius == pytest.approx(np.sqrt(distance.max()))
    squared = np.square(points[:, None] - points[None]).sum(axis=2)
    small = greedy_from_distances(squared[None], count, start)[0]
    assert small[: len(picks)].tolist() == picks
    assert len(set(small.tolist())) == len(small)
