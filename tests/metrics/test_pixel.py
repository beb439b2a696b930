"""The weighted table equals scikit-learn on repeated images, and AUPIMO equals a search over thresholds."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score, roc_auc_score

from calibration.metrics import aupimo, aupimo_means, aupro, auroc, average_precision, pixel_measures
from calibration.metrics.pixel import pool_measures

Array = NDArray[Any]


def scene(seed: int, levels: int = 50, shape: tuple[int, int] = (16, 18)) -> tuple[list[Array], list[Array]]:
    rng = np.random.default_rng(seed)
    masks = [np.zeros(shape, bool) for _ in range(6)]
    for mask in masks[:3]:
        mask[rng.integers(0, 10) :, 3:7] = True
    return [rng.integers(0, levels, shape) + 0.3 * levels * mask for mask in masks], masks


@pytest.mark.parametrize("levels", [3, 50, 10**6])
def test_a_weight_is_a_repetition(levels: int) -> None:
    """An image weighted 3 counts as if it stood in the set three times; weight 0 removes it. To 1e-12."""
    maps, masks = scene(1, levels)
    weights = np.array([[1, 1, 1, 1, 1, 1], [3, 0, 1, 2, 0, 1], [0, 2, 0, 0, 1, 0]], float)
    table = pixel_measures(maps, masks, weights, 0.05)
    for row, weight in enumerate(weights.astype(int)):
        chosen = [i for i, times in enumerate(weight) for _ in range(times)]
        scores = np.concatenate([maps[i].ravel() for i in chosen])
        labels = np.concatenate([masks[i].ravel() for i in chosen])
        assert table.auroc[row] == pytest.approx(roc_auc_score(labels, scores), abs=1e-12)
        assert table.average_precision[row] == pytest.approx(
            average_precision_score(labels, scores), abs=1e-12
        )
        expected = aupro([maps[i] for i in chosen], [masks[i] for i in chosen], 0.05)
        assert table.aupro[row] == pytest.approx(expected, abs=1e-12)


def test_blocks_do_not_change_the_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """One threshold at a time gives the same as all together: nothing is lost between blocks."""
    maps, masks = scene(2)
    weights = np.ones((2, 6))
    whole = pixel_measures(maps, masks, weights)
    monkeypatch.setattr("calibration.metrics.pixel._BLOCK_ELEMENTS", 1)
    single = pixel_measures(maps, masks, weights)
    for name in ("auroc", "average_precision", "aupro"):
        np.testing.assert_allclose(getattr(single, name), getattr(whole, name), atol=1e-12)


def test_weightings_without_a_class_are_nan() -> None:
    """A weighting that removes every defective image leaves NaN for that row alone."""
    maps, masks = scene(3)
    table = pixel_measures(maps, masks, np.array([[0, 0, 0, 1, 1, 1], [1, 1, 1, 1, 1, 1]], float))
    assert np.isnan(table.aupro).tolist() == [True, False]
    assert np.isnan(table.auroc).tolist() == [True, False]


def plain_aupimo(maps: list[Array], masks: list[Array], bounds: tuple[float, float]) -> list[float]:
    """For many rates on the log axis: the lowest threshold whose good rate does not exceed it, then the recall."""
    good = [m for m, k in zip(maps, masks, strict=True) if not k.any()]
    candidates = np.unique(np.concatenate([m.ravel() for m in good]))
    rates = np.array([np.mean([(m > t).mean() for m in good]) for t in candidates])
    grid = np.exp(np.linspace(np.log(bounds[0]), np.log(bounds[1]), 20_001))
    threshold = [candidates[rates <= rate].min() for rate in grid]
    bad = [(m, k) for m, k in zip(maps, masks, strict=True) if k.any()]
    return [float(np.mean([(m[k] > t).mean() for t in threshold])) for m, k in bad]


def test_aupimo_equals_a_fine_search() -> None:
    """The exact integral is that of a 20,001-point search, to the search's own step."""
    maps, masks = scene(4, levels=100)
    bounds = (0.004, 0.06)
    value = aupimo(maps, masks, bounds)
    assert value is not None
    np.testing.assert_allclose(value, plain_aupimo(maps, masks, bounds), atol=2e-4)
    means = aupimo_means(maps, masks, np.array([[1, 1, 1, 1, 1, 1], [2, 0, 0, 1, 1, 1]], float), bounds)
    np.testing.assert_allclose(means, [value.mean(), value[0]], atol=1e-12)


def test_aupimo_of_a_perfect_detector_and_without_good_images() -> None:
    """A map above every good score gives 1; without a good image there is no rate, hence None."""
    maps, masks = scene(5)
    perfect = [mask * 1000.0 for mask in masks]
    value = aupimo(perfect, masks)
    assert value is not None
    assert value.tolist() == [1.0, 1.0, 1.0]
    assert aupimo(maps[:3], masks[:3]) is None
    assert aupimo(maps[3:], masks[3:]) is None


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), levels=st.sampled_from([3, 20, 100_000]), limit=st.floats(0.001, 1.0))
def test_the_values_are_those_of_all_pixels(seed: int, levels: int, limit: float) -> None:
    """With few levels most scores are ties."""
    rng = np.random.default_rng(seed)
    maps = rng.integers(0, levels, (4, 12, 15)).astype(np.float32)
    masks = np.zeros(maps.shape, np.bool_)
    for k in (1, 2):
        y, x = rng.integers(0, 9, 2)
        masks[k, y : y + 3, x : x + 2] = True
        masks[k, 0, 0] = True
        maps[k][masks[k]] += levels // 3
    found = pool_measures(maps, masks, (limit, 0.05))

    assert found.auroc == pytest.approx(auroc(maps.ravel(), masks.ravel()), abs=1e-12)
    assert found.average_precision == pytest.approx(average_precision(maps.ravel(), masks.ravel()), abs=1e-12)
    assert found.aupro[0] == pytest.approx(aupro(maps, masks, limit), abs=1e-9)
    assert found.aupro[1] == pytest.approx(aupro(maps, masks, 0.05), abs=1e-9)


@pytest.mark.parametrize("is_defect", [True, False])
def test_one_class_has_no_measure(is_defect: bool) -> None:
    """Undefined is None, for every limit, of images as of pixels."""
    masks = np.full((2, 3, 3), is_defect)
    found = pool_measures(np.zeros(masks.shape, np.float32), masks, (0.01, 0.05))

    assert (found.auroc, found.average_precision, found.aupro) == (None, None, (None, None))
    assert auroc(np.arange(3.0), masks[0, 0]) is None
    assert average_precision(np.arange(3.0), masks[0, 0]) is None


@pytest.mark.parametrize("limit", [0.0, 1.1])
def test_what_has_no_measure_is_refused(limit: float) -> None:
    """An integration limit is a false-positive rate; each score has one label."""
    with pytest.raises(ValueError, match="an integration limit is in"):
        pool_measures(np.zeros((1, 2, 2)), np.zeros((1, 2, 2), np.bool_), (limit,))
    for measure in (auroc, average_precision):
        with pytest.raises(ValueError, match=r"each score has one label: found \(3,\) scores and \(2,\)"):
            measure(np.arange(3.0), np.array([True, False]))
