"""Measures from one sort are those of the exact functions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.metrics import aupro, auroc, average_precision
from calibration.metrics.pooled import pool_measures


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), levels=st.sampled_from([3, 20, 100_000]), limit=st.floats(0.001, 1.0))
def test_the_values_are_those_of_all_pixels(seed: int, levels: int, limit: float) -> None:
    """With few levels most scores are ties."""
    rng = np.random.default_rng(seed)
    maps = rng.integers(0, levels, (4, 12, 15)).astype(np.float32)
    masks = np.zeros(maps.shape, np.bool_)
    for k in (1, 2):
        y, x = rng.integers(0, 9, 2)
        masks[k, y : y + 3, x : x + 2] = True
        masks[k, 0, 0] = True
        maps[k][masks[k]] += levels // 3
    found = pool_measures(maps, masks, (limit, 0.05))

    assert found.auroc == pytest.approx(auroc(maps.ravel(), masks.ravel()), abs=1e-12)
    assert found.average_precision == pytest.approx(average_precision(maps.ravel(), masks.ravel()), abs=1e-12)
    assert found.aupro[0] == pytest.approx(aupro(maps, masks, limit), abs=1e-9)
    assert found.aupro[1] == pytest.approx(aupro(maps, masks, 0.05), abs=1e-9)


@pytest.mark.parametrize("is_defect", [True, False])
def test_one_class_has_no_measure(is_defect: bool) -> None:
    """Undefined is None, for every limit."""
    maps = np.zeros((2, 3, 3), np.float32)
    found = pool_measures(maps, np.full(maps.shape, is_defect), (0.01, 0.05))

    assert (found.auroc, found.average_precision, found.aupro) == (None, None, (None, None))


@pytest.mark.parametrize("limit", [0.0, 1.1])
def test_a_limit_outside_its_range_is_refused(limit: float) -> None:
    """It is a false-positive rate."""
    with pytest.raises(ValueError, match="an integration limit is in"):
        pool_measures(np.zeros((1, 2, 2)), np.zeros((1, 2, 2), np.bool_), (limit,))
