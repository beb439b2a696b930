"""The PCA subspace: the textbook's residual, the same from the graph, and its limits."""

from typing import Any

import numpy as np
import pytest
from heads import LIKE_RESNET, features, fit, head_scores, largest_error, stored

from edge.core.detector import Features, Nominal
from plugins.detectors.baselines.subspace import subspace

QUERY = features(3, seed=7)


def cells(maps: Features) -> np.ndarray:
    """All channels on layer2's grid, layer1 averaged 2x2, layer3 repeated: float64 (n * 36, 40)."""
    first = maps["layer1"].astype(np.float64).reshape(-1, 8, 6, 2, 6, 2).mean(axis=(3, 5))
    x = np.concatenate([first, maps["layer2"], np.kron(maps["layer3"], np.ones((1, 1, 2, 2)))], axis=1)
    return x.transpose(0, 2, 3, 1).reshape(-1, 40)


def test_the_published_form_is_a_pca_residual() -> None:
    """Paper mode equals scikit-learn's PCA at 99 %: the length of the residual outside the components."""
    decomposition = pytest.importorskip(
        "sklearn.decomposition", reason="SKIPPED, NOT TESTED: scikit-learn is the original"
    )
    parameters = subspace.parameters("paper", sigma=0.0)
    train = features(20, seed=1)
    bank = fit(subspace, parameters, Nominal(train))
    pca = decomposition.PCA(0.99, svd_solver="full").fit(cells(train))
    x = cells(QUERY)
    expected = np.linalg.norm(x - pca.inverse_transform(pca.transform(x)), axis=1).reshape(3, 6, 6)
    assert bank.facts["rank"] == pca.n_components_
    found = subspace.reference_score(QUERY, LIKE_RESNET, bank, parameters)
    up = parameters.smoothing(LIKE_RESNET, (6, 6))
    np.testing.assert_allclose(found.score_map, up(expected), rtol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 30])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"projection": "all"},
        {"projection": "random", "channels": 7},
        {"grid_tap": "layer1"},
        {"most_rank": 3},
    ],
    ids=str,
)
def test_the_graph_equals_the_oracle(n: int, scale: float, choice: dict[str, Any]) -> None:
    """Within 1e-4 of float64 from one press to many and at every scale, also with the bank as stored."""
    parameters = subspace.parameters(**choice)
    bank = fit(subspace, parameters, Nominal(features(n, seed=1, scale=scale)))
    query = features(3, seed=7, scale=scale)
    oracle = subspace.reference_score(query, LIKE_RESNET, bank, parameters)
    assert largest_error(head_scores(subspace, parameters, query, stored(bank)), oracle) < 1e-4


def test_position_does_not_matter() -> None:
    """Presses moved by complete cells of the coarsest tap have the same scores, moved with them."""
    parameters = subspace.parameters(sigma=0.0, grid_tap="layer1")
    bank = fit(subspace, parameters, Nominal(features(20, seed=1)))
    moved = {
        tap: np.roll(value, {"layer1": 4, "layer2": 2, "layer3": 1}[tap], axis=3)
        for tap, value in QUERY.items()
    }
    here, there = (subspace.reference_score(each, LIKE_RESNET, bank, parameters) for each in (QUERY, moved))
    np.testing.assert_allclose(there.score_map[:, :, 20:36], here.score_map[:, :, 4:20], rtol=1e-9)


def test_identical_descriptors_have_no_span() -> None:
    """All cells equal: rank 0, a warning, and the distance to the one descriptor; itself at 0."""
    flat = {tap: np.full((3, *shape), 0.7, np.float32) for tap, shape in LIKE_RESNET.taps.items()}
    bank = fit(subspace, subspace.parameters(), Nominal(flat))
    assert bank.facts["rank"] == 0
    assert bank.facts["warnings"]
    assert head_scores(subspace, subspace.parameters(), flat, bank).score.max() < 1e-3
    assert head_scores(subspace, subspace.parameters(), QUERY, bank).score.min() > 1


def test_the_span_never_fills_the_space() -> None:
    """With as many directions requested as there are channels, one is left out, so that scores are not all 0."""
    parameters = subspace.parameters(projection="random", channels=7, variance=1.0)
    bank = fit(subspace, parameters, Nominal(features(30, seed=1)))
    assert bank.facts["rank"] == 6
    assert head_scores(subspace, parameters, QUERY, bank).score.min() > 0.01
