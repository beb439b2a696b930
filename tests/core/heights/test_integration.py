"""Heights from slopes: the scale of closed forms at every size, and the direct solution of the same equations."""

import numpy as np
import pytest

from edge.core.arrays import F64
from edge.core.heights.height_map import integrate


@pytest.mark.parametrize("sigma", [6, 12, 25, 50])
def test_bumps_of_every_size_have_their_height(sigma: int) -> None:
    """Within 1.1 % from 6 pixels on; the slopes are exact, and the border is far."""
    x, y = np.meshgrid(np.arange(640) - 320.0, np.arange(480) - 240.0)
    bump = np.exp(-(x * x + y * y) / (2 * sigma**2))
    found = integrate(-x / sigma**2 * bump, -y / sigma**2 * bump, (1.0, 1.0))
    assert np.ptp(found) == pytest.approx(1.0, rel=0.011)


@pytest.mark.parametrize("shape", [(12, 16), (2, 14), (10, 4)])
def test_it_is_the_least_squares_solution(shape: tuple[int, int]) -> None:
    """Random slopes, which no surface has: float64, the dense equations, pixels that are not square. Within 1e-10."""
    rng = np.random.default_rng(3)
    gx, gy = rng.normal(size=(2, *shape))
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    rows: list[F64] = []
    wanted: list[float] = []
    for one, other, step in (
        (number[:, :-1], number[:, 1:], (gx[:, :-1] + gx[:, 1:]) / 2 * 0.3),
        (number[:-1], number[1:], (gy[:-1] + gy[1:]) / 2 * 0.5),
    ):
        for a, b, rise in zip(one.ravel(), other.ravel(), step.ravel(), strict=True):
            row = np.zeros(number.size)
            row[[a, b]] = -1, 1
            rows.append(row)
            wanted.append(float(rise))
    direct = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0].reshape(shape)
    found = integrate(gx, gy, (0.3, 0.5))
    assert np.abs(found - (direct - direct.mean())).max() < 1e-10


def test_a_plane_is_a_plane_to_the_border() -> None:
    """No border is bent, as a solver that takes the slope beyond it for 0 would do."""
    found = integrate(np.full((40, 60), 0.1), np.full((40, 60), -0.2), (0.5, 0.25))
    x, y = np.meshgrid(np.arange(60) * 0.05, np.arange(40) * -0.05)
    assert np.abs(found - (x + y - (x + y).mean())).max() < 1e-12
