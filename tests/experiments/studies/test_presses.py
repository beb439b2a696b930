"""Which presses a study uses, and which it holds out."""

from pathlib import Path

import numpy as np
import pytest

from calibration.dataset import Dataset, LabelledPress
from calibration.experiments.harness.pictures import LR_VIEW, PressPictures
from calibration.experiments.harness.presses import StudyPresses, hold_out, presses_of, subset
from edge.core.errors import DatasetError

LR = (320, 240)


def press(
    name: str, specimen: str | None = None, *, size: tuple[int, int] = LR, defect: bool = False
) -> LabelledPress:
    return LabelledPress(Path(name), "PZ1", "pos1", size, specimen, defect="dent" if defect else None)


def dataset(*presses: LabelledPress) -> Dataset:
    return Dataset(Path("data"), "paper", presses)


def nominal(count: int, specimens: int) -> StudyPresses:
    presses = tuple(press(f"{k:03d}.png", f"PZ1_s{k % specimens:03d}") for k in range(count))
    return StudyPresses("PZ1", "pos1", PressPictures(presses, LR_VIEW), count)


def test_nominal_presses_come_first() -> None:
    """Rows of the features: nominal, then defective."""
    found = presses_of(dataset(press("a", defect=True), press("b"), press("c")), "PZ1", "pos1")

    assert [p.path.name for p in found.pictures.presses] == ["b", "c", "a"]
    assert found.nominal == 2
    assert found.defective.tolist() == [2]
    assert found.pictures.view == LR_VIEW


@pytest.mark.parametrize(
    ("presses", "said"),
    [
        ([press("a")], "has no defective press of PZ1/pos1: nothing shows what is found"),
        ([press("a", defect=True)], "has no nominal press of PZ1/pos1; add pictures of sound parts"),
        (
            [press("a"), press("b", size=(640, 480), defect=True)],
            r"has pictures of several sizes \(320x240, 640x480\) at one position",
        ),
    ],
)
def test_presses_that_cannot_be_studied_are_a_sentence(presses: list[LabelledPress], said: str) -> None:
    with pytest.raises(DatasetError, match=said):
        presses_of(dataset(*presses), "PZ1", "pos1")


@pytest.mark.parametrize(("size", "region"), [((640, 480), (224, 224)), ((48, 40), (40, 48))])
def test_other_sizes_are_seen_in_the_middle_or_whole(size: tuple[int, int], region: tuple[int, int]) -> None:
    """The paper's crop where it fits."""
    found = presses_of(dataset(press("a", size=size), press("b", size=size, defect=True)), "PZ1", "pos1")

    assert found.pictures.view.shape == region


def test_a_split_by_press_holds_out_exactly_as_many() -> None:
    """The same ones in every call, and none of them in the pool."""
    held = hold_out(nominal(50, 10), 20, "press")

    assert (len(held.test), len(held.pool)) == (20, 30)
    assert not set(held.test) & set(held.pool)
    assert np.array_equal(held.test, hold_out(nominal(50, 10), 20, "press").test)
    assert not np.array_equal(held.test, hold_out(nominal(50, 10), 20, "press", seed=1).test)


def test_a_split_by_specimen_keeps_specimens_together() -> None:
    """Ten specimens of five presses: twenty presses are four of them."""
    presses = nominal(50, 10)
    held = hold_out(presses, 20, "specimen")
    apart, kept = ({presses.specimens[row] for row in rows} for rows in (held.test, held.pool))

    assert (len(held.test), len(apart)) == (20, 4)
    assert not apart & kept


@pytest.mark.parametrize(
    ("presses", "split", "said"),
    [
        (
            nominal(20, 4),
            "press",
            "has 20 nominal presses, and 20 are held out for the test; press more, or hold",
        ),
        (nominal(30, 1), "specimen", "^PZ1/pos1: a split by specimen needs two specimens, found 1"),
    ],
)
def test_too_few_to_hold_out_is_a_sentence(presses: StudyPresses, split: str, said: str) -> None:
    """No press is left to learn from, or all are of one specimen."""
    with pytest.raises(DatasetError, match=said):
        hold_out(presses, 20, split)  # type: ignore[arg-type]


def test_a_smaller_subset_is_part_of_a_larger_one() -> None:
    """Of one seed, as the prefix of one permutation; another seed draws others."""
    pool = np.arange(100, 200)
    small, large = subset(pool, 5, 3), subset(pool, 50, 3)

    assert set(small) < set(large) < set(pool)
    assert not np.array_equal(small, subset(pool, 5, 4))
    assert np.array_equal(subset(pool, 100, 0), pool)
