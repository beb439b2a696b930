"""A picture smoothed against the noise of its camera."""

import numpy as np
import pytest

from edge.core.imaging.smoothing import smooth


def test_each_pixel_is_the_weighted_mean_of_nine() -> None:
    """The border repeated, the sum exact, halves rounded up."""
    rgb = np.random.default_rng(0).integers(0, 256, (33, 21, 3), dtype=np.uint8)
    wide = np.pad(rgb, ((1, 1), (1, 1), (0, 0)), mode="edge").astype(int)
    weights = (1, 2, 1)
    total = sum(weights[y] * weights[x] * wide[y : y + 33, x : x + 21] for y in range(3) for x in range(3))
    np.testing.assert_array_equal(smooth(rgb), (total + 8) // 16)


def test_it_takes_most_of_the_noise() -> None:
    """Of noise that differs from pixel to pixel 9/64 of the variance are left, and rounding's twelfth."""
    rgb = np.rint(128 + np.random.default_rng(0).normal(0, 8, (200, 200, 3))).astype(np.uint8)
    assert smooth(rgb).std() == pytest.approx(np.sqrt(64 * 9 / 64 + 1 / 12), rel=0.02)
