"""H3: centring makes one eigenvalue zero, and dividing by its root makes a huge direction of rounding noise.

Guards: at most N-1 directions, and none below 1e-14 of the largest (`lowrank.RELATIVE_CUT`). Checked by removal: with
`most = min(n, d)` the first two tests fail, with RELATIVE_CUT = -1 the second (rounding noise counts as directions).
"""

import numpy as np
import pytest
from heads import LIKE_RESNET, features, fit, head_scores, largest_error

from edge.core.detector import Nominal
from plugins.detectors.common.lowrank import mahalanobis_squared, spectrum
from plugins.detectors.padim import padim


@pytest.mark.parametrize(("n", "d"), [(2, 9), (5, 9), (9, 9), (10, 9), (200, 9), (80, 300)])
def test_the_basis_is_orthonormal_or_nothing(n: int, d: int) -> None:
    """Every row is a unit vector orthogonal to the others, or zero with eigenvalue zero; at most N-1 rows."""
    samples = np.random.default_rng(0).normal(3, 1, (4, n, d))
    for rank in (None, 5):
        mean, values, basis = spectrum(samples, rank)
        assert values.shape[1] <= min(n - 1, d)
        for each, rows in zip(values, basis, strict=True):
            np.testing.assert_allclose(rows @ rows.T, np.diag((each > 0).astype(float)), atol=1e-9)
        assert (values >= 0).all()
        np.testing.assert_allclose(mean, samples.mean(axis=1))


@pytest.mark.parametrize("copies", [2, 5, 40])
def test_repeated_presses_add_no_direction(copies: int) -> None:
    """Three presses, each repeated many times: the same two directions."""
    three = np.random.default_rng(1).normal(size=(1, 3, 20))
    values, basis = spectrum(np.repeat(three, copies, axis=1))[1:]
    once = spectrum(three)
    assert (values > 0).sum() == 2
    np.testing.assert_allclose(values[0, :2] * (3 * copies - 1) / copies, once.values[0] * 2, rtol=1e-9)
    np.testing.assert_allclose(np.abs((basis[0, :2] * once.basis[0]).sum(axis=1)), 1, rtol=1e-9)


def test_many_presses_give_the_leading_directions() -> None:
    """Where subspace iteration takes over, the leading eigenvalues are those of the full decomposition."""
    rng = np.random.default_rng(2)
    samples = rng.normal(size=(3, 150, 60)) * np.geomspace(1, 0.01, 60)
    full = spectrum(samples).values[:, :8]
    np.testing.assert_allclose(spectrum(samples, 8).values, full, rtol=1e-3)


@pytest.mark.parametrize(("n", "d"), [(24, 40), (60, 40), (24, 550)])
@pytest.mark.parametrize("times", [1e3, 1e5, 1e6])
def test_a_wide_channel_leaves_the_others_their_directions(n: int, d: int, times: float) -> None:
    """One channel deviates up to a million times more: distances are those of the dense inverse, in float64."""
    rng = np.random.default_rng(0)
    samples, asked = rng.normal(5, 0.3, (n, d)), rng.normal(0, 0.3, (50, d))
    samples[:, 3] *= times
    asked[:, 3] *= times
    found = spectrum(samples)
    dense = np.cov(samples, rowvar=False) + 0.02 * np.eye(d)
    unit = 1 / np.sqrt(np.diag(dense))  # a dense inverse is exact where every channel varies alike
    expected = ((asked * unit) @ np.linalg.inv(dense * unit[:, None] * unit) * (asked * unit)).sum(axis=1)
    np.testing.assert_allclose(
        mahalanobis_squared(asked, found.values, found.basis, 0.02), expected, rtol=1e-3
    )


@pytest.mark.parametrize(
    "parameters",
    [padim.parameters(neighbours=0), padim.parameters("paper", channels=40)],
    ids=["corrected", "paper"],
)
def test_identical_presses_score_finitely(parameters: object) -> None:
    """Equal presses: no direction, they score 0, others a finite distance, and the graph equals the oracle."""
    same = {tap: np.repeat(value, 5, axis=0) for tap, value in features(1, seed=1).items()}
    bank = fit(padim, parameters, Nominal(same))
    query = features(2, seed=7)
    oracle = padim.reference_score(query, LIKE_RESNET, bank, parameters)  # type: ignore[arg-type]
    assert largest_error(head_scores(padim, parameters, query, bank), oracle) < 1e-5
    assert oracle.score.min() > 1
    assert head_scores(padim, parameters, same, bank).score.max() < 1e-3


@pytest.mark.parametrize("frame", [0.0, 3.0], ids=["dead channels", "constant frames"])
def test_dead_channels_and_constant_frames(frame: float) -> None:
    """Constant channels, or presses without structure, give finite scores equal to the oracle's."""
    train = {tap: value.copy() for tap, value in features(6, seed=1).items()}
    train["layer2"][:, :5] = frame
    train["layer3"][:] = frame
    for parameters in (padim.parameters(), padim.parameters("paper", channels=40)):
        bank = fit(padim, parameters, Nominal(train))
        query = features(2, seed=7)
        oracle = padim.reference_score(query, LIKE_RESNET, bank, parameters)
        assert largest_error(head_scores(padim, parameters, query, bank), oracle) < 1e-5
