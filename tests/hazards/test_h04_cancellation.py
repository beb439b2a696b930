"""H4: |a|^2 + |b|^2 - 2ab loses a small distance between large vectors, and can go below zero.

Guards of the oracle in `common/distances.py`: the bank's mean is subtracted from both sides, and the nearest distances
are computed again as sums of squared differences. Checked by removal: without centring the last test fails at the
largest offset. `test_h04_cancellation_in_groups.py` has the float32 graphs.
"""

import numpy as np
import pytest

from plugins.detectors.common.distances import nearest


def test_a_hundredth_between_vectors_of_a_thousand() -> None:
    """Features around 100 in 128 channels, true distance 0.01: within 1 %, where the product form gives noise."""
    rng = np.random.default_rng(0)
    bank = 100 + rng.normal(size=(300, 128))
    step = rng.normal(size=(50, 128))
    queries = bank[:50] + 0.01 * step / np.linalg.norm(step, axis=1, keepdims=True)
    np.testing.assert_allclose(nearest(queries, bank).distances[:, 0], 0.01, rtol=1e-2)
    a, b = queries.astype(np.float32), bank[:50].astype(np.float32)
    product = (a * a).sum(1) + (b * b).sum(1) - 2 * (a * b).sum(1)
    assert np.abs(product - 1e-4).max() > 1e-2


def test_a_row_of_the_bank_is_at_zero() -> None:
    """A query equal to a row has distance exactly 0, never the root of something negative."""
    bank = (100 + np.random.default_rng(1).normal(size=(64, 32))).astype(np.float32)
    assert (nearest(bank, bank).distances == 0).all()


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e9])
def test_the_oracle_is_brute_force_at_any_offset(offset: float) -> None:
    """float64 NumPy: the nearest distance is the smallest of all sums of squared differences, far from zero too."""
    rng = np.random.default_rng(2)
    bank, queries = offset + rng.normal(size=(200, 16)), offset + rng.normal(size=(40, 16))
    expected = np.sqrt(np.square(queries[:, None] - bank[None]).sum(-1)).min(axis=1)
    np.testing.assert_allclose(nearest(queries, bank).distances[:, 0], expected, rtol=1e-5)
