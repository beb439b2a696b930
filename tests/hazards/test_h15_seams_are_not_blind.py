"""H15: windows that reach zero, padding and means over tiles make blind seams and diluted scores.

Guards: windows with a floor and no taper without a neighbour, the last tile shifted (`imaging/tiles.py`); distances
blended raw and blurred once; the score is the map's maximum. Checked by removal: with a Hann window on every side in
`_window` and the sum of weights floored at 1e-6, as in published code, the border of the map is 0 and the first test
fails. With the map's mean in `Smoothing.score_maps` the test of dilution fails.
"""

import numpy as np
import pytest
from heads import features, fit, head_scores, largest_error

from edge.core.detector import Features, Grid, Nominal
from edge.core.imaging.tiles import tiling
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.padim import padim

TILES = tiling((112, 176), 64, 16)
"""Two rows and four columns of tiles, each of 16x16 cells of layer1."""

GRID = Grid(
    (112, 176),
    {"layer1": (6, 16 * 2, 16 * 4), "layer2": (8, 8 * 2, 8 * 4), "layer3": (10, 4 * 2, 4 * 4)},
    15.77,
    TILES,
)
PARAMETERS = padim.parameters(grid_tap="layer1", neighbours=0, sigma=0.0)


def defect_at(row: int, column: int) -> Features:
    """A press with a deviation in the features of one cell of the frame's own grid, in every tile that sees it."""
    query = {tap: value.copy() for tap, value in features(1, GRID, seed=7).items()}
    for i, top in enumerate(TILES.rows):
        for j, left in enumerate(TILES.columns):
            y, x = row - top // 4, column - left // 4
            if 0 <= y < 16 and 0 <= x < 16:
                query["layer1"][0, :, 16 * i + y, 16 * j + x] += 8
    return query


@pytest.fixture(scope="module")
def bank() -> object:
    return fit(padim, PARAMETERS, Nominal(features(20, GRID, seed=1)), GRID)


def test_a_defect_is_seen_wherever_it_lies(bank: object) -> None:
    """On the border, in a corner, on both sides of every seam and in the overlaps: the peak is there, equally high."""
    peaks = []
    places = ((0, 0), (27, 43), (0, 20), (11, 12), (12, 11), (15, 16), (16, 15), (13, 40), (27, 30))
    for row, column in places:
        score_map = padim.reference_score(defect_at(row, column), GRID, bank, PARAMETERS).score_map[0]  # type: ignore[arg-type]
        assert np.unravel_index(score_map.argmax(), score_map.shape) == (4 * row, 4 * column)
        peaks.append(score_map.max())
    assert min(peaks) > 0.5 * max(peaks)


def test_the_layout_has_seams_and_a_shifted_tile() -> None:
    """The tests above cover two rows and four columns of tiles, the last ones shifted."""
    assert (TILES.rows, TILES.columns) == ((0, 48), (0, 48, 96, 112))


@pytest.mark.parametrize(
    "choice",
    [{"taps": ("layer1",), "grid_tap": "layer1"}, {"grid_tap": "layer2"}, {"is_sampled": False}],
    ids=str,
)
@pytest.mark.parametrize("detector", [padim, subspace], ids=lambda d: d.name)
def test_the_graph_equals_the_oracle_on_tiles(detector: object, choice: dict[str, object]) -> None:
    """Blending and blur inside the head: within 2e-6 of float64, with and without a known touch."""
    touched = np.zeros((112, 176), bool)
    touched[40:70, 30:150] = True
    parameters = detector.parameters(**{"taps": ("layer1", "layer2")} | choice)  # type: ignore[attr-defined]
    for mask in (None, touched):
        bank = fit(detector, parameters, Nominal(features(12, GRID, seed=1), mask), GRID)
        query = features(2, GRID, seed=3)
        oracle = detector.reference_score(query, GRID, bank, parameters)  # type: ignore[attr-defined]
        assert largest_error(head_scores(detector, parameters, query, bank, GRID), oracle) < 2e-6


def test_one_defective_tile_is_not_diluted(bank: object) -> None:
    """The score is the maximum of the complete map: one bad cell in one of eight tiles counts fully."""
    odd = padim.reference_score(defect_at(5, 5), GRID, bank, PARAMETERS)  # type: ignore[arg-type]
    plain = padim.reference_score(features(1, GRID, seed=7), GRID, bank, PARAMETERS)  # type: ignore[arg-type]
    assert odd.score[0] == odd.score_map.max() > 2 * plain.score[0]


def test_equal_tiles_give_the_map_of_one_piece() -> None:
    """Where every tile has the features of the complete frame, blending gives the map of a single large grid."""
    whole = Grid((112, 176), {"layer1": (6, 28, 44)}, 15.77)
    tiled = Grid((112, 176), {"layer1": (6, 32, 64)}, 15.77, TILES)
    choice = padim.parameters(grid_tap="layer1", taps=("layer1",), projection="all", rank=None, neighbours=0)

    def mosaic(maps: Features) -> Features:
        rows = [slice(r // 4, r // 4 + 16) for r in TILES.rows]
        columns = [slice(c // 4, c // 4 + 16) for c in TILES.columns]
        x = maps["layer1"]
        return {
            "layer1": np.concatenate([np.concatenate([x[:, :, r, c] for c in columns], 3) for r in rows], 2)
        }

    train, query = features(9, whole, seed=1), features(2, whole, seed=2)
    parameters = type(choice)(**{**choice.__dict__, "is_balanced": False})
    one = padim.reference_score(query, whole, fit(padim, parameters, Nominal(train), whole), parameters)
    many = padim.reference_score(
        mosaic(query), tiled, fit(padim, parameters, Nominal(mosaic(train)), tiled), parameters
    )
    np.testing.assert_allclose(many.score_map, one.score_map, rtol=1e-5)
