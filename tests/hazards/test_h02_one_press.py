"""H2: a single nominal press has no covariance, and NaN slips silently through a maximum.

Guards: one press is defined (rank 0 returns early in `lowrank.spectrum`, and no division by N-1 = 0), features must be
finite at fit, and the graph never turns NaN into a number. Checked by removal: without the first pair the first test
fails; without isfinite in `validation._check_strength` the second; with NaN replaced by 0 before the root the third;
without isfinite in `harness.scoring.score_presses` the last.
"""

import numpy as np
import pytest
import tiny
from heads import LIKE_RESNET, features, fit, head_scores

from calibration.experiments.harness.scoring import score_presses
from calibration.fitting.limits.held_out import Learner
from edge.core.detector import Nominal
from edge.core.errors import FitError, NotScorable
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.padim import padim

QUERY = features(2, seed=7)


def test_one_press_is_defined() -> None:
    """N = 1: the distance is |delta| / sqrt(ridge), the press itself scores 0, and the bank's facts warn."""
    parameters = padim.parameters("paper", channels=40, sigma=0.0)
    train = features(1, seed=1)
    bank = fit(padim, parameters, Nominal(train))
    squared = sum(
        np.kron(((QUERY[tap] - train[tap]) ** 2).sum(axis=1), np.ones((1, k, k)))
        for tap, k in (("layer1", 1), ("layer2", 2), ("layer3", 4))
    )
    expected = parameters.smoothing(LIKE_RESNET, (12, 12))(np.sqrt(squared / 0.02))
    np.testing.assert_allclose(head_scores(padim, parameters, QUERY, bank).score_map, expected, rtol=1e-5)
    assert head_scores(padim, parameters, train, bank).score.max() == 0
    assert "single nominal press" in bank.facts["warnings"][0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("detector", [padim, subspace], ids=lambda d: d.name)
def test_a_fit_refuses_what_is_not_finite(detector: object, bad: float) -> None:
    """One NaN or infinity in one press: FitError naming the press, never a bank."""
    train = {tap: value.copy() for tap, value in features(3, seed=1).items()}
    train["layer2"][1, 0, 0, 0] = bad
    p = detector.parameters(taps=("layer1", "layer2"))  # type: ignore[attr-defined]
    with pytest.raises(FitError, match=r"not finite in nominal presses \[1\]"):
        fit(detector, p, Nominal(train))  # type: ignore[attr-defined]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("detector", [padim, subspace], ids=lambda d: d.name)
def test_nothing_hides_a_nan_from_the_gateway(detector: object, bad: float) -> None:
    """One bad feature anywhere leaves a map that is not finite, which the scorer refuses; the other press is scored."""
    parameters = detector.parameters(taps=("layer1", "layer2"))  # type: ignore[attr-defined]
    touched = np.zeros((48, 48), bool)
    touched[20:30, 20:30] = True
    bank = fit(detector, parameters, Nominal(features(6, seed=1), touched))
    for tap, place in (("layer1", (0, 0)), ("layer1", (6, 6)), ("layer2", (5, 5))):
        query = {name: value.copy() for name, value in QUERY.items()}
        query[tap][0, 0, *place] = bad
        found = head_scores(detector, parameters, query, bank)
        assert not np.isfinite(found.score_map[0]).all()
        assert np.isfinite(found.score_map[1]).all()
        with pytest.raises(NotScorable):
            detector.reference_score(query, LIKE_RESNET, bank, parameters)  # type: ignore[attr-defined]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_study_scores_what_is_not_finite(bad: float) -> None:
    """Studies and trade-off run the head themselves: a press whose score is not finite is refused there too."""
    learner = Learner(tiny.TINY, tiny.tiny_grid(), tiny.TINY.parameters(), 0, 1)
    bank = learner.bank(Nominal({"layer1": np.full((1, 3, 4, 4), 0.5, np.float32)}))

    def score(maps: np.ndarray) -> object:
        return score_presses(learner, bank, {"layer1": maps}, [0])

    asked = np.full((1, 3, 4, 4), 0.5, np.float32)
    score(asked)
    asked[0, 0, 2, 2] = bad
    with pytest.raises(NotScorable, match="not finite"):
        score(asked)
