"""AU-PRO equals the official definition, implemented here a second time in the simplest way."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from calibration.metrics import aupro, pixel_measures

Array = NDArray[Any]


def plain_aupro(maps: list[Array], masks: list[Array], limit: float) -> float:
    """Every pixel sorted, one step at a time, in Python numbers."""
    pixels = []
    regions = 0
    for score_map, mask in zip(maps, masks, strict=True):
        labels, count = ndimage.label(mask, structure=np.ones((3, 3)))
        regions += count
        for r, c in np.ndindex(mask.shape):
            area = int((labels == labels[r, c]).sum()) if labels[r, c] else 0
            pixels.append((float(score_map[r, c]), area))
    pixels.sort(key=lambda p: -p[0])
    sound = sum(1 for _, area in pixels if not area)
    points = [(0.0, 0.0)]
    fp, pro = 0, 0.0
    for k, (score, area) in enumerate(pixels):
        fp, pro = fp + (not area), pro + (1 / area if area else 0.0)
        if k + 1 == len(pixels) or pixels[k + 1][0] != score:
            points.append((fp / sound, min(pro / regions, 1.0)))
    points.append((1.0, 1.0))
    total = 0.0
    for (x0, y0), (x1, y1) in pairwise(points):
        if x0 >= limit:
            break
        if x1 > limit:
            y1 = y0 + (y1 - y0) * (limit - x0) / (x1 - x0)
            x1 = limit
        total += (x1 - x0) * (y0 + y1) / 2
    return total / limit


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    levels=st.sampled_from([1, 2, 3, 7, 1000, 10**9]),
    limit=st.sampled_from([0.001, 0.01, 0.05, 0.3, 1.0]),
    density=st.sampled_from([0.02, 0.2, 0.7]),
)
def test_equals_the_plain_definition(seed: int, levels: int, limit: float, density: float) -> None:
    """On random, tied and near-degenerate maps the value is that of the plain definition to 1e-9."""
    rng = np.random.default_rng(seed)
    maps = [rng.integers(0, levels, (9, 11)).astype(np.float64) for _ in range(3)]
    masks = [rng.random((9, 11)) < density for _ in range(2)] + [np.zeros((9, 11), bool)]
    masks[0][4, 5] = True
    expected = plain_aupro(maps, masks, limit)
    assert aupro(maps, masks, limit) == pytest.approx(expected, abs=1e-9)
    table = pixel_measures(maps, masks, np.ones((1, 3)), limit)
    assert table.aupro[0] == pytest.approx(expected, abs=1e-9)


def test_perfect_reversed_and_constant_maps() -> None:
    """A map equal to its mask gives 1, its negative 0, and a constant map the diagonal: limit / 2."""
    mask = np.zeros((20, 20), bool)
    mask[3:6, 4:9] = True
    good = np.zeros((20, 20), bool)
    maps = [mask.astype(np.float32), good.astype(np.float32)]
    assert aupro(maps, [mask, good], 0.01) == pytest.approx(1.0, abs=1e-12)
    assert aupro([-maps[0], maps[1]], [mask, good], 0.01) == 0.0
    flat = np.full((20, 20), 3.0)
    assert aupro([flat, flat], [mask, good], 0.01) == pytest.approx(0.005, abs=1e-12)


def test_worked_by_hand() -> None:
    """Two regions of 1 and 2 pixels among 9 sound ones: the small one above all, the other below one sound."""
    score_map = np.array([[9.0, 0, 0, 7], [0, 0, 8, 5], [0, 0, 0, 0]])
    mask = np.zeros((3, 4), bool)
    mask[0, 0] = mask[0, 3] = mask[1, 3] = True
    sound_zeroes = (score_map == 0).sum()
    score_map[score_map == 0] = -np.arange(sound_zeroes) - 1.0
    # Order: region A (9), sound (8), half of B (7), half of B (5), then sound pixels only.
    expected = (1 / 9 * 0.5 + (0.25 - 1 / 9) * 1.0) / 0.25
    assert aupro([score_map], [mask], 0.25) == pytest.approx(expected, abs=1e-12)


def test_undefined_is_none() -> None:
    """Without a defect, without a sound pixel or without images the value is None."""
    zero = np.zeros((4, 4))
    assert aupro([zero], [zero > 1]) is None
    assert aupro([zero], [zero < 1]) is None
    assert aupro([], []) is None


@pytest.mark.parametrize(
    ("score_map", "mask", "message"),
    [
        (np.full((4, 4), np.nan), np.ones((4, 4), bool), "NaN"),
        (np.zeros((4, 4)), np.ones((4, 5), bool), "must be equal"),
        (np.zeros((4, 4)), np.ones((4, 4), np.uint8), "must be bool"),
    ],
)
def test_refuses_what_has_no_rank(score_map: Array, mask: Array, message: str) -> None:
    """Non-finite maps, other sizes and integer masks are refused with an error that names the image."""
    with pytest.raises(ValueError, match=f"image 0.*{message}"):
        aupro([score_map], [mask])
    with pytest.raises(ValueError, match="limit"):
        aupro([np.zeros((4, 4))], [np.eye(4, dtype=bool)], 0.0)
