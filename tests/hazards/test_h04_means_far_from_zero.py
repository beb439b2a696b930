"""H4, stored: for large features that differ little, float16 rounding of their mean exceeds the scored differences.

Guard: PaDiM stores means and projections as float32 where float16 would change a press by 5 % of the difference between
nominal presses (`padim.fit._loses_in_halves`). `fit` warns where a tap differs by less than the floor of its deviation,
whatever the method (`features.feature_warnings`). Checked by removal: with float16 always the first test finds 17 to
47 % of the peak; without the warnings the third fails.
"""

import numpy as np
import pytest
from heads import LIKE_RESNET, features, fit, head_scores, largest_error, stored

from calibration.fitting.features import feature_warnings
from edge.core.detector import Features, Nominal
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.padim import padim


def raised(maps: Features, offset: float) -> Features:
    return {tap: value + np.float32(offset) for tap, value in maps.items()}


@pytest.mark.parametrize("offset", [0.0, 1e2, 1e3, 1e4])
def test_a_stored_bank_keeps_features_far_from_zero(offset: float) -> None:
    """Features of 0.3 around 1e4: the graph with the stored bank is within 1 % of the oracle with the unstored one."""
    p = padim.parameters()
    bank = fit(padim, p, Nominal(raised(features(20, seed=1), offset)))
    asked = raised(features(2, seed=7), offset)
    expected = padim.reference_score(asked, LIKE_RESNET, bank, p)
    assert largest_error(head_scores(padim, p, asked, stored(bank)), expected) < 0.01


@pytest.mark.parametrize("detector", [padim, subspace], ids=lambda d: d.name)
def test_the_graph_is_the_oracle_far_from_zero(detector: object) -> None:
    """All features raised by 300, a thousand times their variation: the graph keeps the oracle's map to 0.1 %."""
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = fit(detector, p, Nominal(raised(features(20, seed=1), 300)))
    asked = raised(features(2, seed=7), 300)
    expected = detector.reference_score(asked, LIKE_RESNET, bank, p)  # type: ignore[attr-defined]
    assert largest_error(head_scores(detector, p, asked, bank), expected) < 1e-3


@pytest.mark.parametrize(("offset", "scale"), [(1e2, 1.0), (1e3, 1e-3), (1e5, 1.0), (1e6, 1.0)])
def test_a_tap_that_hardly_differs_is_named(offset: float, scale: float) -> None:
    """Where features differ by less than 1 % of their size, faint defects are missed with any method: `fit` warns."""
    assert not feature_warnings(Nominal(features(20, seed=1)), LIKE_RESNET)
    found = feature_warnings(Nominal(raised(features(20, seed=1, scale=scale), offset)), LIKE_RESNET)
    assert len(found) == 3
    assert "'layer1' differs between nominal presses by less than 1% of its size" in found[0]
