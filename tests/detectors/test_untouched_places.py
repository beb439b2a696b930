"""Places that no nominal press touches keep no rows of presses: they are compared with the free gel.

Checked by removal: with `gel_weight` fixed at 1 gel that varies raises alarms; without the gel's mean in
`emit_gel_distances` graph and oracle differ; without `absent` in the window's search SPADE's do.
"""

from functools import cache
from typing import Any

import heads
import numpy as np
import pytest
from heads import around, run_head, stored_bytes

from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.imaging.tiles import tiling
from plugins.detectors.fapm import fapm
from plugins.detectors.spade import spade

FRAME = (128, 128)
TAPS = {"layer1": (16, 32, 32), "layer2": (24, 16, 16)}
GRID = Grid(FRAME, TAPS, 15.77)
TILED = Grid((96, 128), {"layer1": (32, 32, 48)}, 15.77, tiling((96, 128), 64, 32))
# The part touches the upper left; 1 mm around it counts as touched.
TOUCHED = np.zeros(FRAME, bool)
TOUCHED[:48, :48] = True
KEPT = np.s_[:64, :64]
BEYOND = np.ones(FRAME, bool)
BEYOND[KEPT] = False
NEAR, FAR = (24, 24), (108, 108)
"""A pixel that nominal presses touch, and one that they never do."""

METHODS = {
    "fapm": (fapm, {}),
    "fapm calibrated": (fapm, {"is_calibrated": True}),
    "spade": (spade, {}),
    "spade in few directions": (spade, {"dims": (7,), "is_normalised": True}),
    "spade of two layers": (spade, {"layers": ("layer1", "layer2"), "dims": ()}),
    "fapm of two layers": (fapm, {"layers": ("layer1", "layer2"), "weighting": "largest"}),
}
EACH = pytest.mark.parametrize("method", METHODS)


def frames(n: int, seed: int, touched: np.ndarray = TOUCHED, restless: float = 1.0) -> Features:
    """n presses: still gel with a little noise, and where it is touched a relief that varies from press to press.
    restless: the factor of the gel's noise outside the touched places."""
    part, rng = np.random.default_rng(7), np.random.default_rng(seed)
    found = {}
    for tap, shape in TAPS.items():
        here = touched[:: FRAME[0] // shape[1], :: FRAME[1] // shape[2]]
        gel, relief = part.uniform(1, 2, (shape[0], 1, 1)), part.normal(0, 1, shape)
        varied = relief + rng.normal(0, 0.2, (n, *shape))
        noise = rng.normal(0, 0.02, (n, *shape)) * np.where(
            BEYOND[:: FRAME[0] // shape[1]][:, :: FRAME[1] // shape[2]], restless, 1.0
        )
        found[tap] = (gel + noise + here * varied).astype(np.float32)
    return found


@cache
def fitted(method: str, is_touched: bool = True, restless: float = 1.0) -> Bank:
    """Of 30 presses, with the free gel where the touch is known."""
    detector, choice = METHODS[method]
    free = frames(3, 5, np.zeros(FRAME, bool), restless)
    known = (TOUCHED, free) if is_touched else ()
    nominal = Nominal(frames(30, 0, restless=restless), *known)
    return heads.fit(detector, detector.parameters(**choice), nominal, GRID)


def scored(method: str, bank: Bank, asked: Features) -> np.ndarray:
    detector, choice = METHODS[method]
    return run_head(detector.head(GRID, bank, detector.parameters(**choice)), asked, bank)["score_map"][0]


def check_oracle(detector: Any, p: Any, bank: Bank, grid: Grid, asked: Features) -> None:
    """Map and score agree to 1e-5 for several presses at once."""
    oracle = detector.reference_score(asked, grid, bank, p)
    found = run_head(detector.head(grid, bank, p), asked, bank)
    assert np.abs(found["score_map"] - oracle.score_map).max() < 1e-5 * oracle.score_map.max()
    np.testing.assert_allclose(found["score"], oracle.score, atol=1e-5 * oracle.score_map.max())


@EACH
def test_the_graph_is_the_oracle_and_the_bank_shrinks(method: str) -> None:
    """No press touches two thirds of the gel: the bank has at most 60 % of the bytes."""
    detector, choice = METHODS[method]
    whole, small = fitted(method, is_touched=False), fitted(method)
    assert [any("gel" in name for name in bank.arrays) for bank in (whole, small)] == [False, True]
    assert stored_bytes(small) < 0.6 * stored_bytes(whole)
    asked = {tap: np.concatenate([maps, 1.5 * maps]) for tap, maps in frames(2, 1).items()}
    check_oracle(detector, detector.parameters(**choice), small, GRID, asked)


@EACH
def test_a_press_where_none_belongs_scores_high_and_gel_does_not(method: str) -> None:
    """A relief like the part's, on gel that no nominal press touched, scores above all nominal places. The gel's own
    noise there, even thirty times that of before, stays below where rows are kept."""
    far = np.zeros(FRAME, bool)
    far[96:, 96:] = True
    usual, foreign = (scored(method, fitted(method), frames(1, 2, TOUCHED | more)) for more in (TOUCHED, far))
    restless = scored(method, fitted(method, restless=30.0), frames(1, 2, restless=30.0))
    assert around(foreign, FAR) > 2 * usual.max()
    assert np.unravel_index(foreign.argmax(), FRAME) > (90, 90)
    for found in (usual, restless):
        assert around(found, FAR) < found[KEPT].max()


@EACH
def test_without_frames_of_the_free_gel(method: str) -> None:
    """The presses themselves show the gel where none of them touches it; one press alone does too."""
    detector, choice = METHODS[method]
    for n in (1, 12):
        bank = heads.fit(detector, detector.parameters(**choice), Nominal(frames(n, 0), TOUCHED), GRID)
        found = scored(method, bank, frames(1, 2))
        assert np.isfinite(found).all()
        assert around(found, FAR) < around(found, NEAR)


@pytest.mark.parametrize("detector", [fapm, spade], ids=lambda d: d.name)
def test_the_published_mode_knows_no_touch(detector: Any) -> None:
    """`paper` keeps rows everywhere, touched or not."""
    p = detector.parameters("paper", layers=("layer1", "layer2"))
    bank = heads.fit(detector, p, Nominal(frames(6, 0), TOUCHED, frames(2, 1)), GRID)
    assert not any("gel" in name for name in bank.arrays)


LARGE = Grid((224, 224), {"layer1": (64, 56, 56)}, 15.77)


@pytest.mark.parametrize("detector", [fapm, spade], ids=lambda d: d.name)
@pytest.mark.parametrize(
    ("grid", "top", "left", "n", "choice"),
    [(TILED, 60, 100, 30, {"margin_mm": 0.25}), (LARGE, 100, 200, 7, {})],
    ids=["tiles", "large"],
)
def test_a_small_touch(
    detector: Any, grid: Grid, top: int, left: int, n: int, choice: dict[str, float]
) -> None:
    """On a mosaic each tile has its own touched places; on a large grid most parts of a search are empty: the graph
    equals the oracle, and the bank of tiles is smaller."""
    rng = np.random.default_rng(0)
    nominal, asked = (
        {"layer1": rng.normal(1, 0.1, (count, *grid.taps["layer1"])).astype(np.float32)} for count in (n, 2)
    )
    touched = np.zeros(grid.frame, bool)
    touched[top : top + 10, left : left + 10] = True
    p = detector.parameters(**choice)
    bank, whole = (heads.fit(detector, p, Nominal(nominal, t), grid) for t in (touched, None))
    assert grid is LARGE or stored_bytes(bank) < 0.6 * stored_bytes(whole)
    check_oracle(detector, p, bank, grid, asked)
