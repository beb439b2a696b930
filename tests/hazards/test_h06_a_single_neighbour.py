"""H6: a softmax over one neighbour is 1, the published weight 1 - 1 = 0, and the worst press scores 0.

Guard: `is_single_unweighted` in `plugins/detectors/fapm`: fewer than two neighbours or prototypes, no weight.
Checked by removal:
with `fapm.head.is_unweighted` always false both tests fail (scores of 0, weights of 3/4).
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head

from plugins.detectors.fapm import fapm


@pytest.mark.parametrize("weighting", ["largest", "nearest"])
def test_one_neighbour_leaves_the_distance_as_the_score(weighting: str) -> None:
    """k = 1: the published score is 0 for every press; ours is the largest distance, in oracle and graph."""
    asked = presses_of(2, 1)
    for is_unweighted in (True, False):
        p = fapm.parameters(weighting=weighting, neighbours=1, is_single_unweighted=is_unweighted)
        bank = fit(fapm, p, presses_of(20), grid())
        found = run_head(fapm.head(grid(), bank, p), asked, bank)
        oracle = fapm.reference_score(asked, grid(), bank, p).score
        np.testing.assert_allclose(found["score"], oracle, rtol=1e-5, atol=1e-6)
        expected = found["raw_map"].max(axis=(1, 2)) if is_unweighted else np.zeros(2)
        np.testing.assert_allclose(oracle, expected, rtol=1e-5, atol=1e-6)


def test_one_prototype_counts_as_one_neighbour() -> None:
    """M = 1: the only distance is repeated to k, and the published weight is a constant 3/4 that means nothing."""
    asked = presses_of(2, 1)
    for is_unweighted, weight in ((True, 1.0), (False, 0.75)):
        p = fapm.parameters(
            weighting="largest", banks="location", far_factor=1.0, is_single_unweighted=is_unweighted
        )
        bank = fit(fapm, p, presses_of(5), grid())
        assert bank.arrays["layer1_far"].shape[1] == 1
        found = run_head(fapm.head(grid(), bank, p), asked, bank)
        np.testing.assert_allclose(found["score"], weight * found["raw_map"].max(axis=(1, 2)), rtol=1e-5)
        assert any("no second neighbour" in warning for warning in bank.facts["warnings"])
