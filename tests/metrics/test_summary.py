"""The summary of a set: names that carry limits, reasons, and intervals that widen with specimens."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.metrics import Measure, image_weights, limit_name, measure, specimen_weights

Array = NDArray[Any]


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
    """The intervals depend only on the seed."""
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
    """The digits after the point."""
    named = {0.01: "aupro_fpr01", 0.3: "aupro_fpr3", 0.05: "aupro_fpr05", 1.0: "aupro_fpr1"}
    assert {limit: limit_name(limit) for limit in named} == named


def test_labels_may_say_more_than_masks() -> None:
    """A bad part whose press left no imprint counts as defective by image and as sound pixel by pixel."""
    maps, masks, scores, ids = presses(np.random.default_rng(3))
    label = masks.any(axis=(1, 2))
    label[-1] = True
    measures = by_name(measure(maps, masks, scores, ids, is_defective=label, replicates=0))
    assert measures["image_auroc"].value is not None
    assert measures["image_auroc"].over_images is None
