"""Bytes of a bank for 1280x720, in one piece and in tiles of 224, with all of the frame touched and with a quarter.

Run with `pytest tests/bench/test_large_banks.py -m bench -s`. Budget: 64 MB as stored. The features are noise of the
taps' sizes: how many bytes a bank takes depends on sizes alone. SPADE and FAPM keep presses, so theirs grows; the
others' has what it may have after a few presses.
"""

import time
from typing import Any

import numpy as np
import pytest
from heads import run_head, stored_bytes

from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.imaging.tiles import tiling
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade

pytestmark = pytest.mark.bench

FRAME = (720, 1280)
PIXELS_PER_MM = 63.1
# A ResNet-18's: how many channels, and how many cells a tile of 224 has along a side.
TAPS = {"layer1": (64, 56), "layer2": (128, 28)}
TILES = tiling(FRAME)
WAYS = {
    "one piece": Grid(
        FRAME,
        {tap: (c, FRAME[0] * side // 224, FRAME[1] * side // 224) for tap, (c, side) in TAPS.items()},
        PIXELS_PER_MM,
    ),
    "tiles": Grid(
        FRAME,
        {tap: (c, side * len(TILES.rows), side * len(TILES.columns)) for tap, (c, side) in TAPS.items()},
        PIXELS_PER_MM,
        TILES,
    ),
}
QUARTER = np.zeros(FRAME, bool)
QUARTER[180:540, 320:960] = True
MOST_BYTES = 64e6
# Presses that are fitted.
GROWING = {spade: 12, fapm: 12}
STEADY = {padim: 3, inreach: 3, patchcore: 3, subspace: 3}
# By how much more presses may change the bytes of the steady ones: the span of what was pressed has no fixed rank.
SPAN = 0.02


def noise(detector: Any, grid: Grid, presses: int) -> tuple[Grid, Features]:
    """The grid of what the detector reads, and as many presses of it."""
    read = detector.taps(detector.parameters())
    own = Grid(grid.frame, {tap: grid.taps[tap] for tap in read}, grid.pixels_per_mm, grid.tiles)
    rng = np.random.default_rng(0)
    return own, {tap: rng.standard_normal((presses, *own.taps[tap]), np.float32) for tap in read}


def fitted(detector: Any, grid: Grid, features: Features, touched: np.ndarray | None) -> Bank:
    bank: Bank = detector.fit(
        Nominal(features, touched),
        grid,
        detector.parameters(),
        np.random.default_rng(0),
        lambda done: None,
    )
    return bank


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("detector", [*GROWING, *STEADY], ids=lambda d: d.name)
def test_bytes_of_large_banks(detector: Any, way: str) -> None:
    """Prints one line per touched area; the bank is never beyond 64 MB, and its head scores a press."""
    presses = (GROWING | STEADY)[detector]
    grid, features = noise(detector, WAYS[way], presses + 1)
    nominal, asked = (
        {tap: maps[rows] for tap, maps in features.items()} for rows in (slice(1, None), slice(1))
    )
    for area, touched in (("all touched", None), ("a quarter touched", QUARTER)):
        began = time.perf_counter()
        bank = fitted(detector, grid, nominal, touched)
        fit_s = time.perf_counter() - began
        head = detector.head(grid, bank, detector.parameters())
        assert np.isfinite(run_head(head, asked, bank)["score_map"]).all()
        size = stored_bytes(bank)
        shapes = ", ".join(f"{name} {array.shape}" for name, array in bank.arrays.items())
        print(
            f"\n{detector.name:9s} {way:10s} {area:18s} {presses} presses: {size / 1e6:6.2f} MB, "
            f"fit {fit_s:5.1f} s  {shapes}  {'; '.join(bank.facts['warnings'])}"
        )
        assert size <= MOST_BYTES


@pytest.mark.parametrize("detector", STEADY, ids=lambda d: d.name)
def test_banks_that_do_not_grow(detector: Any) -> None:
    """Twice the presses take the same bytes."""
    grid, features = noise(detector, WAYS["one piece"], 2 * STEADY[detector])
    few = {tap: maps[: STEADY[detector]] for tap, maps in features.items()}
    sizes = [stored_bytes(fitted(detector, grid, maps, QUARTER)) for maps in (few, features)]
    print(f"\n{detector.name:9s} {sizes}", end="")
    assert sizes[1] <= (1 + SPAN) * sizes[0]
