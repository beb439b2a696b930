"""H5, nearest neighbours: exp of a distance above 88, and distances whose squares exceed float16's range.

Guards: FAPM's weight subtracts the largest distance before exp (`is_softmax_stable`), distances are always float32, and
float16 is for storage alone. Checked by removal: without the subtraction, in graph or oracle, the first test fails;
with squared distances limited to float16's 65504 in `emit_group_nearest` the first and the third fail.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head, stored

from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade


@pytest.mark.parametrize("weighting", ["largest", "nearest"])
def test_the_weight_survives_large_distances(weighting: str) -> None:
    """Distances of thousands: published, exp overflows and the press has no score; ours is the same formula, finite."""
    nominal, asked = presses_of(20, scale=1e4), presses_of(1, 1, scale=1e4)
    for is_stable in (True, False):
        p = fapm.parameters(weighting=weighting, is_calibrated=False, is_softmax_stable=is_stable)
        bank = fit(fapm, p, nominal, grid())
        graph = run_head(fapm.head(grid(), bank, p), asked, bank)["score"]
        with np.errstate(all="ignore"):
            oracle = fapm.reference_score(asked, grid(), bank, p).score
        assert np.isfinite(graph).all() == is_stable
        if is_stable:
            np.testing.assert_allclose(graph, oracle, rtol=1e-3)


def test_the_stable_weight_is_the_same_number() -> None:
    """Where nothing overflows the subtraction changes nothing."""
    nominal, asked = presses_of(20), presses_of(3, 1)
    scores = []
    for is_stable in (True, False):
        p = fapm.parameters(weighting="largest", is_softmax_stable=is_stable)
        scores.append(fapm.reference_score(asked, grid(), fit(fapm, p, nominal, grid()), p).score)
    np.testing.assert_allclose(scores[0], scores[1], rtol=1e-12)


@pytest.mark.parametrize("detector", [spade, fapm, inreach, patchcore], ids=lambda d: d.name)
@pytest.mark.parametrize("outlier", [1e3, 3e4, 1e6])
def test_a_far_outlier_against_a_bank_in_halves(detector: object, outlier: float) -> None:
    """A bank stored as float16 and a press up to a million times brighter: finite, and equal to the oracle to 1e-4."""
    p = detector.parameters(packing="float16")  # type: ignore[attr-defined]
    bank = stored(fit(detector, p, presses_of(12), grid()))  # type: ignore[arg-type]
    asked = presses_of(2, 1, scale=outlier)
    found = run_head(detector.head(grid(), bank, p), asked, bank)["score_map"]  # type: ignore[attr-defined]
    expected = detector.reference_score(asked, grid(), bank, p).score_map  # type: ignore[attr-defined]
    assert np.abs(found - expected).max() < 1e-4 * expected.max()
