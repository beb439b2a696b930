"""H20: sampled thresholds, another connectivity and 32-bit counters make PRO at 0.01 wrong by a factor of two."""

import numpy as np

from calibration.metrics.pixel import aupro, pixel_measures


def test_sampled_thresholds_would_differ() -> None:
    """With 100 evenly placed thresholds, as one published script does, the value at 0.01 is far off; ours is not."""
    rng = np.random.default_rng(20)
    mask = np.zeros((100, 100), bool)
    mask[40:50, 40:50] = True
    maps = [rng.normal(size=mask.shape) + 2.5 * mask, rng.normal(size=mask.shape)]
    masks = [mask, np.zeros_like(mask)]
    sound = np.sort(np.concatenate([m[~k] for m, k in zip(maps, masks, strict=True)]))
    thresholds = sound[np.linspace(0, sound.size - 1, 100).astype(int)][::-1]
    fpr = np.array([(sound >= t).mean() for t in thresholds])
    pro = np.array([(maps[0][mask] >= t).mean() for t in thresholds])
    keep = fpr <= 0.01
    sampled = float(np.trapezoid(pro[keep], fpr[keep])) / 0.01
    exact = aupro(maps, masks, 0.01)
    assert exact is not None
    fine = np.unique(np.concatenate([sound, maps[0][mask]]))[::-1]
    xs = np.concatenate([[0], [(sound >= t).mean() for t in fine[:600]]])
    ys = np.concatenate([[0], [(maps[0][mask] >= t).mean() for t in fine[:600]]])
    grid = np.linspace(0, 0.01, 200_001)
    assert abs(np.interp(grid, xs, ys).mean() - exact) < 2e-3
    assert abs(sampled - exact) > 0.1


def test_a_thin_scratch_is_one_region() -> None:
    """Twenty diagonal pixels are one region, and with a single pixel there are two; else there would be 21."""
    mask = np.eye(20, dtype=bool)
    mask[19, 0] = True  # a region of its own
    scores = np.zeros((20, 20))
    scores[19, 0] = 1.0
    assert abs((aupro([scores], [mask], 1e-4) or 0) - 0.5) < 1e-4


def test_ties_are_one_threshold_in_both_counts() -> None:
    """With two score levels the curve has one corner, in any order of the pixels."""
    mask = np.zeros((10, 10), bool)
    mask[0, :4] = True
    scores = np.zeros((10, 10))
    scores[0, :2] = scores[5, :3] = 1.0
    corner = 3 / 96
    at_limit = 0.5 + 0.5 * (0.1 - corner) / (1 - corner)
    expected = (corner * 0.25 + (0.1 - corner) * (0.5 + at_limit) / 2) / 0.1
    for flipped in (slice(None), slice(None, None, -1)):
        value = aupro([scores[flipped, flipped]], [mask[flipped, flipped]], 0.1)
        assert value is not None
        assert abs(value - expected) < 1e-12


def test_counts_pass_the_float32_wall() -> None:
    """Above 2**24 sound pixels a float32 count stops; the table continues."""
    mask = np.zeros((1, 8), bool)
    mask[0, 0] = True
    score_map = np.arange(8, dtype=np.float64)[None]
    heavy = np.array([[float(2**24 + 1)]])
    once = pixel_measures([score_map], [mask], np.ones((1, 1)), 0.5)
    many = pixel_measures([score_map], [mask], heavy, 0.5)
    assert once.aupro[0] == many.aupro[0]
    assert once.auroc[0] == many.auroc[0]
