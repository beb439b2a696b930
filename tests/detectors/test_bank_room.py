"""What a bank of limited size may keep: a fold's share of the limit, and every place that the free gel has."""

from dataclasses import replace
from typing import Any

import heads
import numpy as np
import pytest

from edge import registry
from edge.core.detector import Detector, Grid, Nominal
from plugins.detectors.common.patchbank import of_every_place

GRID = heads.grid(heads.RESNET18)


def numbers_kept(detector: Detector, nominal: Nominal, limits: dict[str, Any]) -> int:
    """How many numbers the bank's largest array holds."""
    parameters = detector.parameters(**limits)
    grid = replace(GRID, taps={tap: GRID.taps[tap] for tap in detector.taps(parameters)})
    bank = detector.fit(nominal, grid, parameters, np.random.default_rng(0), lambda done: None)
    return max(array.size for array in bank.arrays.values())


@pytest.mark.parametrize(
    ("method", "limits"),
    [
        ("patchcore", {"most_rows": 64, "most_patches": 4096}),
        ("inreach", {"most_rows": 64, "most_patches": 64}),
        ("spade", {"bank_mb": 2.0}),
        ("fapm", {"bank_mb": 0.3}),
    ],
)
def test_half_the_room_is_half_the_bank(method: str, limits: dict[str, Any]) -> None:
    """The room is a factor on the limit: a fold's bank keeps the same share of its presses as the bank does of all."""
    detector = registry.detector(method)
    nominal = Nominal(heads.presses_of(12, taps={"layer1": GRID.taps["layer1"]}))
    whole, half = (numbers_kept(detector, replace(nominal, room=room), limits) for room in (1.0, 0.5))
    assert 0.4 < half / whole < 0.6


def test_a_room_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="positive factor"):
        Nominal({}, room=0.0)


@pytest.mark.parametrize(
    ("n", "places", "most", "each"), [(40, 100, 350, 3), (5, 100, 4096, 5), (40, 100, 10, 1)]
)
def test_every_place_is_drawn_equally_often(n: int, places: int, most: int, each: int) -> None:
    """At most one row per press of each place, and no place left out."""
    rows = np.stack(np.meshgrid(np.arange(n), np.arange(places), indexing="ij"), axis=2).astype(np.float32)
    found = of_every_place(rows, most, np.random.default_rng(0))
    assert np.bincount(found[:, 1].astype(int), minlength=places).tolist() == [each] * places
    assert len(np.unique(found, axis=0)) == len(found)


def test_no_place_at_all_gives_no_rows() -> None:
    """A part that fills the picture leaves no free gel."""
    assert of_every_place(np.zeros((4, 0, 3), np.float32), 10, np.random.default_rng(0)).shape == (0, 3)


@pytest.mark.parametrize("method", ["inreach", "patchcore"])
def test_a_corner_that_every_press_has_is_in_the_bank(method: str) -> None:
    """One untouched cell of 12,544 looks like no other; a press scores no higher there than anywhere."""
    maps = np.abs(np.random.default_rng(9).normal(1, 0.1, (4, 16, 112, 112))).astype(np.float32)
    maps[:, ::2, -1, -1] += 4
    touched = np.zeros((448, 448), bool)
    touched[120:240, 120:240] = True
    detector = registry.detector(method)
    grid = Grid((448, 448), {"layer1": (16, 112, 112)}, GRID.pixels_per_mm)
    parameters = detector.parameters(sigma=0.0, dims=None)
    nominal = Nominal({"layer1": maps}, touched)
    bank = detector.fit(nominal, grid, parameters, np.random.default_rng(0), lambda done: None)
    score_map = detector.reference_score({"layer1": maps[:1]}, grid, bank, parameters).score_map[0]
    assert score_map[-3:, -3:].max() <= 1.2 * score_map[:-8, :-8].max()
