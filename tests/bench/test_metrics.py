"""Exact AU-PRO against sorting every pixel, on a set of the paper's size."""

import time

import numpy as np
import pytest
from scipy import ndimage

from calibration.metrics import aupro, measure

pytestmark = pytest.mark.bench


def paper_sized() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """20 good and 21 defective presses of 224x224, one to three defects each."""
    rng = np.random.default_rng(0)
    masks = [np.zeros((224, 224), bool) for _ in range(41)]
    for mask in masks[:21]:
        for _ in range(rng.integers(1, 4)):
            r, c = rng.integers(0, 190, 2)
            mask[r : r + rng.integers(5, 30), c : c + rng.integers(5, 30)] = True
    maps = [ndimage.gaussian_filter(rng.normal(size=m.shape) + 2.0 * m, 4).astype(np.float32) for m in masks]
    return maps, masks


def full_sort(maps: list[np.ndarray], masks: list[np.ndarray], limit: float) -> float:
    """The simple way: label, stack, argsort all pixels, cumulate, integrate."""
    fp, pro, regions = [], [], 0
    for mask in masks:
        labels, count = ndimage.label(mask, structure=np.ones((3, 3), int))
        share = np.zeros(mask.shape)
        for k in range(1, count + 1):
            share[labels == k] = 1 / (labels == k).sum()
        fp.append(labels == 0)
        pro.append(share)
        regions += count
    score = np.stack(maps).ravel()
    order = np.argsort(score)[::-1]
    false_positive = np.stack(fp).ravel()[order]
    x = np.cumsum(false_positive, dtype=np.int64) / false_positive.sum()
    y = np.cumsum(np.stack(pro).ravel()[order]) / regions
    last = np.append(np.diff(score[order]) != 0, True)
    x, y = np.append(0, x[last]), np.append(0, y[last])
    inside = int(np.searchsorted(x, limit, side="right"))
    slope = (y[inside] - y[inside - 1]) / (x[inside] - x[inside - 1])
    end = y[inside - 1] + slope * (limit - x[inside - 1])
    return float(np.trapezoid(np.append(y[:inside], end), np.append(x[:inside], limit))) / limit


def best_of(n: int, call: object) -> float:
    times = []
    for _ in range(n):
        start = time.process_time()
        call()  # type: ignore[operator]
        times.append(time.process_time() - start)
    return min(times)


def test_partition_against_full_sort() -> None:
    """Both give the same value; the printed ratio is the gain."""
    maps, masks = paper_sized()
    assert abs((aupro(maps, masks, 0.01) or 0) - full_sort(maps, masks, 0.01)) < 1e-9
    plain = best_of(3, lambda: full_sort(maps, masks, 0.01))
    ours = best_of(3, lambda: aupro(maps, masks, 0.01))
    gain = f"full sort {plain * 1e3:.0f} ms, partition {ours * 1e3:.0f} ms, {plain / ours:.1f}x"
    print(f"\nAU-PRO@0.01, 41 maps 224x224: {gain}")


def test_whole_summary() -> None:
    """All measures with 1000 + 1000 bootstrap replicates."""
    maps, masks = paper_sized()
    scores = np.array([m.max() for m in maps])
    ids = [str(k // 4) for k in range(41)]
    took = best_of(1, lambda: measure(maps, masks, scores, ids))
    print(f"\nfive measures, two intervals of 1000 replicates each: {took:.1f} s")
