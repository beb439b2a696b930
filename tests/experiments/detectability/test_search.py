"""The smallest size found: halving, and what counts as found."""

from dataclasses import dataclass

import numpy as np
import pytest
import tiny
from numpy.typing import NDArray
from pressed_dome import REGION, Bench

from calibration.experiments.detectability.judges import Judge, sizes_mm, smallest_found
from calibration.fitting.damage.damage import Damage, Spot
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress
from edge.model.manifest import ToleranceEntry
from edge.model.scorer import Scored

SIZES = sizes_mm("dent")


@pytest.mark.parametrize("limit", [0.001, 0.008, 0.05, 0.39, 0.4])
def test_halving_brackets_the_smallest_size_found(limit: float) -> None:
    """Seven looks at most, and the bracket is between neighbours of the ladder."""
    looks: list[float] = []

    def is_found(size: float) -> bool:
        looks.append(size)
        return size >= limit

    low, high = smallest_found(is_found, SIZES)
    assert low < limit <= high or (low, high) == (0.0, SIZES[0])
    assert high == SIZES[0] if low == 0 else SIZES.index(high) == SIZES.index(low) + 1
    assert len(looks) <= 7


@dataclass
class Peaked:
    """Stands for a scorer: gives this score, with the map's peak at one pixel."""

    score_given: float
    peak: tuple[int, int]

    def score(self, rgb: NDArray[np.uint8]) -> Scored:
        score_map = np.zeros(rgb.shape[:2], np.float32)
        score_map[self.peak] = self.score_given
        return Scored(score_map, self.score_given, 0.0, 0.0)


@pytest.fixture
def press(station: Station, bench: Bench) -> EditedPress:
    return EditedPress(station, np.ascontiguousarray(REGION.crop(bench.press(0))))


def judge(score: float, peak: tuple[int, int]) -> Judge:
    tolerance = ToleranceEntry(score=0.1, score_map=0.1, relative=0.0, measured=0.0)
    manifest, _ = tiny.tiny_files(threshold=1.0, tolerance=tolerance)
    return Judge(Peaked(score, peak), manifest)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("score", "column", "is_found"),
    [
        (0.9, 48, False),
        (1.0, 48, False),
        (1.05, 48, False),
        (1.2, 48, True),
        (2.0, 70, True),
        (2.0, 88, False),
    ],
)
def test_a_fail_finds_the_damage(press: EditedPress, score: float, column: int, is_found: bool) -> None:
    """By the bundle's limit and tolerance: unsure is no find. The map is highest on the damage, or within a cell."""
    assert judge(score, (48, column)).finds(press, Damage("dent", 0.1, Spot(0, 0, 0))) is is_found


@pytest.mark.parametrize(("score", "passes"), [(0.5, True), (1.0, False), (1.2, False)])
def test_a_press_that_fails_or_is_unsure_is_no_pass(press: EditedPress, score: float, passes: bool) -> None:
    """Such a press is not edited: a find on it would prove nothing."""
    assert judge(score, (0, 0)).passes(press.rgb) is passes
