"""Dense covariances become thin: the directions of the presses, whatever the file's rounding adds."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from export.importers.padim_parts import Gaussians, Reduced, reduce_matrices

RIDGE = 0.01
PLACES, CHANNELS, PRESSES = 6, 60, 5


def covariances(largest: float) -> NDArray[np.float64]:
    """Of five presses at six places, with the ridge; the directions' variances go up to about `largest`."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(PLACES, PRESSES, CHANNELS)) * np.sqrt(largest / CHANNELS)
    centred = features - features.mean(axis=1, keepdims=True)
    return centred.swapaxes(1, 2) @ centred / (PRESSES - 1) + RIDGE * np.eye(CHANNELS)


def thin(matrices: NDArray[np.float32] | NDArray[np.float64], is_inverse: bool) -> Reduced:
    path, mean = Path("padim.ckpt"), np.zeros((PLACES, 1))
    given = Gaussians(path, "cov", (), np.zeros(0, np.int64), mean, lambda part: matrices[part], is_inverse)
    return reduce_matrices(given, None)


@pytest.mark.parametrize("largest", [0.1, 100.0, 3000.0])
def test_the_rounding_of_an_inverse_is_no_direction(largest: float) -> None:
    """anomalib stores inverses in float32: at a condition of 3e5 their ridge is off by hundredths, and stays one."""
    found = thin(np.linalg.inv(covariances(largest).astype(np.float32)), is_inverse=True)

    assert found.basis.shape == (PLACES, PRESSES - 1, CHANNELS)
    assert found.ridge == pytest.approx(RIDGE, rel=1e-3)
    assert found.loss < 0.1


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_neither_is_that_of_a_covariance(dtype: type) -> None:
    """The same of covariances as the scripts store them."""
    found = thin(covariances(3000.0).astype(dtype), is_inverse=False)

    assert found.basis.shape == (PLACES, PRESSES - 1, CHANNELS)
    assert found.ridge == pytest.approx(RIDGE, rel=1e-3)


def test_every_direction_of_many_presses_is_kept() -> None:
    """Where no eigenvalue is a ridge, all directions but those of the smallest stay."""
    spread = np.linspace(1, 2, CHANNELS)
    found = thin(np.stack([np.diag(spread)] * PLACES), is_inverse=False)

    assert found.rank == CHANNELS - 1
    assert found.loss < 1e-3
