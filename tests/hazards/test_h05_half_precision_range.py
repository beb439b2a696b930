"""H5: float16 holds 65504 at most; squared distances, large means and far outliers do not fit.

Guards: float16 is for storage alone (divided by a power of two), everything in a graph is float32. Checked by
removal: with the exponent in `packing.py` fixed at 0 the first test fails (overflow at 1e6, 4 % error at 1e-6).
With the squared distances cast to float16 before the root in `padim.head` both fail (NaN and 0).
"""

import pytest
from heads import LIKE_RESNET, features, fit, head_scores, largest_error, stored

from edge.core.detector import Nominal
from plugins.detectors.padim import padim


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("packing", ["float16", "int8"])
def test_a_bank_of_large_or_tiny_features_survives_storage(scale: float, packing: str) -> None:
    """Means of 1e6 and of 1e-6 come back from float16 within the bound that holds at scale 1."""
    for mode in ("corrected", "paper"):
        parameters = padim.parameters(mode, packing=packing)
        bank = fit(padim, parameters, Nominal(features(20, seed=1, scale=scale)))
        query = features(2, seed=7, scale=scale)
        oracle = padim.reference_score(query, LIKE_RESNET, bank, parameters)
        assert largest_error(head_scores(padim, parameters, query, stored(bank)), oracle) < 0.02


@pytest.mark.parametrize("outlier", [1e3, 3e4, 1e6])
def test_a_far_outlier_has_a_finite_score(outlier: float) -> None:
    """A press a million times brighter than any nominal one: a distance far beyond 256 (its square exceeds float16)."""
    parameters = padim.parameters()
    bank = stored(fit(padim, parameters, Nominal(features(20, seed=1))))
    query = features(2, seed=7, scale=outlier)
    found = head_scores(padim, parameters, query, bank)
    assert found.score.min() > 256
    assert largest_error(found, padim.reference_score(query, LIKE_RESNET, bank, parameters)) < 1e-5
