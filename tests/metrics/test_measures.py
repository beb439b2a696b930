"""The weighted table, AU-PRO and AUPIMO equal other definitions; a summary has limits, reasons and intervals."""

import importlib
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.metrics.aupimo import aupimo_means
from calibration.metrics.pixel import aupro, pixel_measures, pool_measures
from calibration.metrics.summary import (
    Measure,
    auroc,
    image_weights,
    limit_name,
    measure,
    specimen_weights,
)

Array = NDArray[Any]


def scene(seed: int, levels: int = 50, shape: tuple[int, int] = (16, 18)) -> tuple[list[Array], list[Array]]:
    rng = np.random.default_rng(seed)
    masks = [np.zeros(shape, bool) for _ in range(6)]
    for mask in masks[:3]:
        mask[rng.integers(0, 10) :, 3:7] = True
    return [rng.integers(0, levels, shape) + 0.3 * levels * mask for mask in masks], masks


@pytest.fixture(scope="module")
def oracle() -> Any:
    """Return scikit-learn's measures. Its import takes longer than these tests, in every process that collects them."""
    return importlib.import_module("sklearn.metrics")


@pytest.mark.parametrize("levels", [3, 50, 10**6])
def test_a_weight_is_a_repetition(levels: int, oracle: Any) -> None:
    """An image weighted 3 counts as if it stood in the set three times; weight 0 removes it. To 1e-12."""
    maps, masks = scene(1, levels)
    weights = np.array([[1, 1, 1, 1, 1, 1], [3, 0, 1, 2, 0, 1], [0, 2, 0, 0, 1, 0]], float)
    table = pixel_measures(maps, masks, weights, 0.05)
    for row, weight in enumerate(weights.astype(int)):
        chosen = [i for i, times in enumerate(weight) for _ in range(times)]
        scores = np.concatenate([maps[i].ravel() for i in chosen])
        labels = np.concatenate([masks[i].ravel() for i in chosen])
        assert table.auroc[row] == pytest.approx(oracle.roc_auc_score(labels, scores), abs=1e-12)
        assert table.average_precision[row] == pytest.approx(
            oracle.average_precision_score(labels, scores), abs=1e-12
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
    expected = plain_aupimo(maps, masks, bounds)
    means = aupimo_means(maps, masks, np.array([[1, 1, 1, 1, 1, 1], [2, 0, 0, 1, 1, 1]], float), bounds)
    np.testing.assert_allclose(means, [np.mean(expected), expected[0]], atol=2e-4)


def test_aupimo_of_a_perfect_detector_and_without_good_images() -> None:
    """A map above every good score gives 1; without a good image there is no rate, hence NaN."""
    maps, masks = scene(5)
    perfect = [mask * 1000.0 for mask in masks]
    assert aupimo_means(perfect, masks, np.ones((1, 6))).tolist() == [1.0]
    for some in (slice(3), slice(3, None)):
        assert np.isnan(aupimo_means(maps[some], masks[some], np.ones((1, 3)))).all()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), levels=st.sampled_from([3, 20, 100_000]), limit=st.floats(0.001, 1.0))
def test_the_values_are_those_of_all_pixels(oracle: Any, seed: int, levels: int, limit: float) -> None:
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
    assert found.average_precision == pytest.approx(
        oracle.average_precision_score(masks.ravel(), maps.ravel()), abs=1e-12
    )
    assert found.aupro[0] == pytest.approx(aupro(maps, masks, limit), abs=1e-9)
    assert found.aupro[1] == pytest.approx(aupro(maps, masks, 0.05), abs=1e-9)


@pytest.mark.parametrize("is_defect", [True, False])
def test_one_class_has_no_measure(is_defect: bool) -> None:
    """Undefined is None, for every limit, of images as of pixels."""
    masks = np.full((2, 3, 3), is_defect)
    found = pool_measures(np.zeros(masks.shape, np.float32), masks, (0.01, 0.05))

    assert (found.auroc, found.average_precision, found.aupro) == (None, None, (None, None))
    assert auroc(np.arange(3.0), masks[0, 0]) is None


@pytest.mark.parametrize("limit", [0.0, 1.1])
def test_what_has_no_measure_is_refused(limit: float) -> None:
    """An integration limit is a false-positive rate; each score has one label."""
    with pytest.raises(ValueError, match="an integration limit is in"):
        pool_measures(np.zeros((1, 2, 2)), np.zeros((1, 2, 2), np.bool_), (limit,))
    with pytest.raises(ValueError, match=r"each score has one label: found \(3,\) scores and \(2,\)"):
        auroc(np.arange(3.0), np.array([True, False]))


def test_a_defective_press_with_an_empty_mask_is_no_good_image() -> None:
    """Its map is high, as it should be: as a good image it would raise the threshold for the others."""
    maps, masks, scores, _ = presses(np.random.default_rng(0))
    maps, label = maps.copy(), np.arange(30) < 15
    maps[0] = 10.0
    marked, unmarked = masks.copy(), masks.copy()
    marked[0], unmarked[0] = True, False
    whole, half = (
        by_name(measure(maps, some, scores, is_defective=label, replicates=0)) for some in (marked, unmarked)
    )
    assert half["aupimo_1e-5_1e-4"].value == pytest.approx(15 / 14 * whole["aupimo_1e-5_1e-4"].value - 1 / 14)


def presses(
    rng: np.random.Generator, specimens: int = 6, each: int = 5
) -> tuple[Array, Array, Array, list[str]]:
    """Specimens differ more from each other than their presses do; half of them are defective."""
    ids = [f"s{k}" for k in range(specimens) for _ in range(each)]
    masks = np.zeros((len(ids), 12, 12), bool)
    masks[: len(ids) // 2, 2:5, 2:6] = True
    offset = np.repeat(rng.normal(size=specimens), each)
    maps = rng.normal(size=masks.shape) * 0.2 + masks * 1.0 + offset[:, None, None]
    return maps, masks, maps.max(axis=(1, 2)), ids


def by_name(measures: tuple[Measure, ...]) -> dict[str, Measure]:
    return {m.name: m for m in measures}


def test_names_and_intervals() -> None:
    """Each measure is in its intervals; specimens are fewer and correlated, so their interval is wider."""
    maps, masks, scores, ids = presses(np.random.default_rng(0))
    measures = by_name(measure(maps, masks, scores, ids, replicates=200))
    assert list(measures) == ["image_auroc", "pixel_auroc", "pixel_auprc", "aupro_fpr01", "aupimo_1e-5_1e-4"]
    for one in measures.values():
        assert one.value is not None
        assert one.over_images is not None
        assert one.over_images[0] <= one.value <= one.over_images[1]
    pixel = measures["pixel_auroc"]
    assert pixel.over_images is not None
    assert pixel.over_specimens is not None
    assert np.diff(pixel.over_specimens)[0] > np.diff(pixel.over_images)[0]


def test_same_seed_same_intervals() -> None:
    maps, masks, scores, ids = presses(np.random.default_rng(1))
    one, again, other = (measure(maps, masks, scores, ids, replicates=50, seed=seed) for seed in (3, 3, 4))
    assert one == again != other


@pytest.mark.parametrize(
    ("keep", "reason"),
    [
        (slice(0, 15), "no good press"),
        (slice(15, 30), "no defective press"),
        (slice(0, 0), "there is no press"),
    ],
)
def test_undefined_has_a_reason(keep: slice, reason: str) -> None:
    """Without one of the classes the image AUROC is None, and says which class is missing."""
    maps, masks, scores, ids = presses(np.random.default_rng(2))
    measures = by_name(measure(maps[keep], masks[keep], scores[keep], ids[keep], replicates=10))
    assert measures["image_auroc"].value is None
    assert reason in str(measures["image_auroc"].reason)


def test_a_specimen_moves_as_one_and_classes_are_kept() -> None:
    """All presses of a specimen share a weight, and each replicate draws as many good and bad units as there are."""
    label = np.array([True, True, False, False, False, False])
    weights = specimen_weights(["a", "a", "b", "b", "c", "c"], label, 100, np.random.default_rng(0))
    assert (weights[:, 0::2] == weights[:, 1::2]).all()
    assert (weights[:, 0] == 1).all()
    assert (weights[:, 2] + weights[:, 4] == 2).all()
    images = image_weights(label, 100, np.random.default_rng(0))
    assert (images[:, :2].sum(axis=1) == 2).all()
    assert (images.sum(axis=1) == 6).all()


def test_the_name_carries_the_limit() -> None:
    named = {
        0.01: "aupro_fpr01",
        0.3: "aupro_fpr3",
        0.05: "aupro_fpr05",
        0.1: "aupro_fpr1",
        1.0: "aupro_fpr1.0",
    }
    named[1e-7] = "aupro_fpr0000001"
    assert {limit: limit_name(limit) for limit in named} == named


def test_labels_may_say_more_than_masks() -> None:
    """A bad part whose press left no imprint counts as defective by image and as sound pixel by pixel."""
    maps, masks, scores, ids = presses(np.random.default_rng(3))
    label = masks.any(axis=(1, 2))
    label[-1] = True
    measures = by_name(measure(maps, masks, scores, ids, is_defective=label, replicates=0))
    assert measures["image_auroc"].value is not None
    assert measures["image_auroc"].over_images is None


def plain_aupro(maps: list[Array], masks: list[Array], limit: float) -> float:
    """Every pixel sorted, one step at a time, in Python numbers."""
    pixels = []
    regions = 0
    for score_map, mask in zip(maps, masks, strict=True):
        labels, count = scipy.ndimage.label(mask, structure=np.ones((3, 3)))
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
