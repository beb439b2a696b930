"""PatchCore's and InReaCh's banks hold the cells that nominal presses touch, and some free gel.

Neither knows places, so free gel is compared with the same rows as everything else. Checked by removal: with rows of
all cells instead of `touched` ones, or more free gel than `FREE_GEL_ROWS`, free gel fills the bank. With the mask not
in the order of the tiles, or without its margin, the rows are of other cells. Without `free_gel` gel that varies raises
alarms; without its frames, or its cells of presses, so does gel that only those show. A stray press needs no guard:
its test fails when the map is set to zero beyond the touched cells.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest
from heads import around, run_head

from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.imaging.tiles import tiling
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.common.tile_layout import split
from plugins.detectors.inreach import inreach

CHANNELS, SIDE = 16, 56
FRAME = (4 * SIDE, 4 * SIDE)
GRID = Grid(FRAME, {"layer1": (CHANNELS, SIDE, SIDE)}, 15.77)
TILED = Grid((96, 128), {"layer1": (CHANNELS, 32, 48)}, 15.77, tiling((96, 128), 64, 32))
# The part touches the upper left; 1 mm around it, not quite four cells, counts as touched.
TOUCHED = np.zeros(FRAME, bool)
TOUCHED[:32, :32] = True
NOWHERE = np.zeros(FRAME, bool)
FAR_QUARTER = np.zeros(FRAME, bool)
FAR_QUARTER[168:, 168:] = True
KEPT = np.zeros((SIDE, SIDE), bool)
KEPT[:12, :12] = True
NEAR, FAR = (16, 16), (188, 188)
"""A pixel that nominal presses touch, and one that they never do."""

# Every direction unchanged, so that a row of the bank is identified by its bytes.
EXACT = {"dims": None, "is_balanced": False}
EACH = pytest.mark.parametrize("detector", [patchcore, inreach], ids=lambda d: d.name)


@cache
def _drawn(n: int, seed: int, noise: float) -> list[np.ndarray]:
    """What is the same for every place that is touched: gel, relief, the ways in which the gel moves, and its noise."""
    part, rng = np.random.default_rng(7), np.random.default_rng(seed)
    shape = (n, CHANNELS, SIDE, SIDE)
    gel = part.uniform(1, 2, (CHANNELS, 1, 1))
    relief, ways = part.normal(0, 1, shape[1:]), part.normal(0, 1, (2, CHANNELS))
    varied = relief + rng.normal(0, 0.2, shape)
    moved = np.einsum("nkhw,kc->nchw", rng.normal(0, 1, (n, 2, SIDE, SIDE)), ways)
    return [gel + rng.normal(0, 1, shape) * np.where(KEPT, 0.02, noise), varied, moved]


def frames(
    n: int, seed: int, touched: np.ndarray = TOUCHED, moving: float = 0.0, noise: float = 0.02
) -> Features:
    """n presses: gel with a little noise, and where it is touched a relief that differs by 0.2 from press to press.
    Elsewhere the gel may vary. moving: by how much, in the same two directions at every cell. noise: by how much each
    number varies independently."""
    gel, varied, moved = _drawn(n, seed, noise)
    return {"layer1": (gel + touched[::4, ::4] * varied + moving * moved * ~KEPT).astype(np.float32)}


def fitted(detector: Any, nominal: Nominal, grid: Grid = GRID, **choice: Any) -> tuple[Any, Bank]:
    p = detector.parameters(**choice)
    return p, detector.fit(nominal, grid, p, np.random.default_rng(0), lambda done: None)


def scored(detector: Any, p: Any, bank: Bank, asked: Features) -> np.ndarray:
    return run_head(detector.head(GRID, bank, p), asked, bank)["score_map"][0]


def touched_of_tiles(touched: np.ndarray) -> np.ndarray:
    """Which cells of the mosaic see a touched pixel, or one within 1 mm: (32, 48), worked from the tiles' edges."""
    assert TILED.tiles is not None
    down, across = TILED.tiles.edges((16, 16))
    kept = np.zeros((32, 48), bool)
    for row, top in enumerate(down):
        for column, left in enumerate(across):
            low = [max(0, int(np.floor(edge - TILED.pixels_per_mm))) for edge in (top, left)]
            high = [int(np.ceil(edge + 4 + TILED.pixels_per_mm)) for edge in (top, left)]
            kept[row, column] = touched[low[0] : high[0], low[1] : high[1]].any()
    return kept


def touched_rows(p: Any, bank: Bank, nominal: Features, grid: Grid, kept: np.ndarray) -> int:
    """The number of rows of the bank that are of these cells (rows, columns) of the nominal presses."""
    cells = split(kept[None, None], grid).ravel()
    rows = p.rows.rows(nominal, grid, bank.arrays, np.float32)[:, cells]
    known = {row.tobytes() for row in rows.reshape(-1, rows.shape[2])}
    return sum(row.tobytes() in known for row in bank.arrays["bank"])


@EACH
def test_free_gel_does_not_fill_the_bank(detector: Any) -> None:
    """95 % of the gel is free and varies like the presses: 60 % of the rows are of touched cells. The facts have the
    number of the others."""
    features = frames(24, 0, noise=0.2)
    nominal = Nominal(features, TOUCHED, frames(3, 5, NOWHERE, noise=0.2))
    p, bank = fitted(detector, nominal, **EXACT)
    count = touched_rows(p, bank, features, GRID, KEPT)
    assert count > 0.6 * len(bank.arrays["bank"])
    assert bank.facts["rows_of_free_gel"] == len(bank.arrays["bank"]) - count


@EACH
def test_free_gel_does_not_fill_the_bank_of_tiles(detector: Any) -> None:
    """The touched cells of a mosaic are found in the order in which its tiles give their rows."""
    rng, touched = np.random.default_rng(0), np.zeros(TILED.frame, bool)
    touched[60:70, 100:110] = True
    features = {"layer1": rng.normal(1, 0.1, (12, *TILED.taps["layer1"])).astype(np.float32)}
    p, bank = fitted(detector, Nominal(features, touched), TILED, **EXACT)
    count = touched_rows(p, bank, features, TILED, touched_of_tiles(touched))
    assert count == len(bank.arrays["bank"]) - bank.facts["rows_of_free_gel"]
    assert count > 0


@EACH
@pytest.mark.parametrize(
    ("moving", "is_shown"), [(0.0, True), (0.3, True), (1.0, True), (0.0, False), (0.3, False), (1.0, False)]
)
def test_a_foreign_press_scores_high_restless_gel_not(detector: Any, moving: float, is_shown: bool) -> None:
    """Gel that moves where nothing touches, even further than presses differ, scores below what is touched, with frames
    of free gel and of presses alone. A relief there scores above all nominal places. Map and score are the oracle's."""
    free = frames(3, 5, NOWHERE, moving) if is_shown else None
    p, bank = fitted(detector, Nominal(frames(24, 0, moving=moving), TOUCHED, free))
    usual = scored(detector, p, bank, frames(1, 2, moving=moving))
    assert around(usual, FAR) < around(usual, NEAR)
    if not is_shown or moving > 0.3:
        return
    asked = frames(1, 2, TOUCHED | FAR_QUARTER, moving)
    oracle = detector.reference_score(asked, GRID, bank, p)
    found = run_head(detector.head(GRID, bank, p), asked, bank)
    (foreign,) = found["score_map"]
    assert around(foreign, FAR) > 2 * usual.max()
    assert min(np.unravel_index(foreign.argmax(), FRAME)) > 160
    assert np.abs(foreign - oracle.score_map).max() < 1e-5 * oracle.score_map.max()
    np.testing.assert_allclose(found["score"], oracle.score, atol=1e-5 * oracle.score_map.max())


@EACH
def test_frames_of_the_free_gel_count_where_every_place_is_touched(detector: Any) -> None:
    """With presses that touch the complete frame, an untouched place is anomalous unless the fit had such frames."""
    # The corner that is touched, repeated over the frame.
    nominal, asked = (np.tile(frames(n, n)["layer1"][:, :, :8, :8], (1, 1, 7, 7)) for n in (24, 1))
    free = frames(3, 5, NOWHERE)
    asked[:, :, 42:, 42:] = free["layer1"][:1, :, 42:, 42:]
    score = {}
    for is_shown in (True, False):
        given = Nominal({"layer1": nominal}, ~NOWHERE, free if is_shown else None)
        p, bank = fitted(detector, given)
        score[is_shown] = around(scored(detector, p, bank, {"layer1": asked}), FAR)
    assert score[True] < 0.25 * score[False]


@EACH
def test_the_published_mode_knows_no_touch(detector: Any) -> None:
    """`paper` takes its rows from every cell, touched or not."""
    choice = {"patchcore": {"layers": ("layer1",)}, "inreach": {"taps": ("layer1",), "is_fallback": True}}
    features = {"layer1": frames(4, 0)["layer1"][:, :, ::4, ::4]}
    grid = Grid(FRAME, {"layer1": features["layer1"].shape[1:]}, 15.77)
    banks = [
        fitted(
            detector, n, grid, mode="paper", grid_tap="layer1", descriptor="cells", **choice[detector.name]
        )[1]
        for n in (Nominal(features, TOUCHED, features), Nominal(features))
    ]
    np.testing.assert_array_equal(banks[0].arrays["bank"], banks[1].arrays["bank"])
    assert banks[0].facts["rows_of_free_gel"] == 0
