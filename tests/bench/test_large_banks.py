"""Bytes of a bank for 1280x720, in one piece and in tiles of 224, with all of the frame touched and with a quarter.

Run with `pytest tests/bench/test_large_banks.py -m bench -s`. Budget: 64 MB as stored. The features are noise of the
taps' sizes: how many bytes a bank takes depends on sizes alone.
"""

import time
from typing import Any

import numpy as np
import pytest
from heads import run_head, stored_bytes

from edge.core.detector import Grid, Nominal
from edge.core.tiles import tiling
from plugins.detectors.fapm import fapm
from plugins.detectors.spade import spade

pytestmark = pytest.mark.bench

FRAME = (720, 1280)
PIXELS_PER_MM = 63.1
PRESSES = 12
CHANNELS = 64
TILES = tiling(FRAME)
WAYS = {
    "one piece": Grid(FRAME, {"layer1": (CHANNELS, 180, 320)}, PIXELS_PER_MM),
    "tiles": Grid(
        FRAME,
        {"layer1": (CHANNELS, 56 * len(TILES.rows), 56 * len(TILES.columns))},
        PIXELS_PER_MM,
        TILES,
    ),
}
QUARTER = np.zeros(FRAME, bool)
QUARTER[180:540, 320:960] = True


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("detector", [spade, fapm], ids=lambda d: d.name)
def test_bytes_of_large_banks(detector: Any, way: str) -> None:
    """Prints one line per touched area; the bank is never beyond 64 MB."""
    grid = WAYS[way]
    rng = np.random.default_rng(0)
    features = {"layer1": rng.standard_normal((PRESSES + 1, *grid.taps["layer1"]), np.float32)}
    nominal, asked = ({"layer1": features["layer1"][rows]} for rows in (slice(1, None), slice(1)))
    for area, touched in (("all touched", None), ("a quarter touched", QUARTER)):
        p = detector.parameters()
        began = time.perf_counter()
        bank = detector.fit(Nominal(nominal, touched), grid, p, np.random.default_rng(0), lambda done: None)
        fit_s = time.perf_counter() - began
        assert np.isfinite(run_head(detector.head(grid, bank, p), asked, bank)["score_map"]).all()
        size = stored_bytes(bank)
        print(
            f"\n{detector.name:6s} {way:10s} {area:18s} {PRESSES} presses: {size / 1e6:6.2f} MB, "
            f"fit {fit_s:5.1f} s  {'; '.join(bank.facts['warnings'])}"
        )
        assert size <= 64e6
