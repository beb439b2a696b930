"""Tiles: a picture that is cut and joined is unchanged; windows leave no seam."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.imaging.tiles import FLOOR, Tiles, tiling


def test_the_papers_layout() -> None:
    """1280x720 in tiles of 224 with 56 in common: 4 rows and 8 columns, the last of each shifted to the border."""
    tiles = tiling((720, 1280))
    assert tiles.rows == (0, 168, 336, 496)
    assert tiles.columns == (0, 168, 336, 504, 672, 840, 1008, 1056)
    assert len(tiles) == 32


sizes = st.tuples(st.integers(1, 4), st.integers(0, 3), st.integers(0, 40), st.integers(0, 40))


@given(sizes)
def test_cut_and_put_together_is_the_same(size: tuple[int, int, int, int]) -> None:
    """For any frame, tile and overlap: blending the tiles of a grid gives the grid, so the weights sum to 1."""
    side, overlap, more_rows, more_columns = (
        4 * size[0],
        4 * min(size[1], size[0] - 1),
        4 * size[2],
        4 * size[3],
    )
    tiles = tiling((side + more_rows, side + more_columns), side, overlap)
    cells = side // 4
    grid = np.random.default_rng(0).normal(size=(tiles.frame[0] // 4, tiles.frame[1] // 4))
    mosaic = np.block(
        [[grid[r // 4 : r // 4 + cells, c // 4 : c // 4 + cells] for c in tiles.columns] for r in tiles.rows]
    )
    rows, columns = tiles.blend_rows(cells), tiles.blend_columns(cells)
    np.testing.assert_allclose(rows @ mosaic @ columns.T, grid, rtol=1e-12, atol=1e-12)
    assert rows.min() >= 0


@given(sizes)
def test_every_pixel_is_in_a_tile(size: tuple[int, int, int, int]) -> None:
    """Nothing is left out, and no tile reaches beyond the frame."""
    side, overlap = 3 * size[0], min(size[1], 3 * size[0] - 1)
    tiles = tiling((side + size[2], side + size[3]), side, overlap)
    seen = np.zeros(tiles.frame, int)
    for row, column in tiles.places:
        seen[row : row + side, column : column + side] += 1
    assert seen.min() >= 1
    frame = np.arange(seen.size, dtype=np.uint32).reshape(seen.shape).astype(np.uint8)
    assert tiles.cut(frame).shape == (len(tiles), side, side)


def test_no_window_reaches_zero() -> None:
    """The weight of a tile's outermost cell, against its neighbour's, is at least the floor's share."""
    rows = tiling((720, 1280)).blend_rows(56)
    taken = rows[rows > 0]
    assert taken.min() >= FLOOR / (1 + FLOOR)


def test_a_side_without_neighbour_is_not_tapered() -> None:
    """The first and last cells of the frame come from their one tile at full weight."""
    columns = tiling((224, 1280)).blend_columns(28)
    assert columns[0, 0] == columns[-1, -1] == 1
    assert (tiling((224, 224)).blend_rows(28) == np.eye(28)).all()


def test_a_falling_weight_is_linear_in_the_overlap() -> None:
    """Two tiles of 8 cells with 4 in common: 1/8, 3/8, 5/8 and 7/8 of the second tile."""
    blend = tiling((48, 32), 32, 16).blend_rows(8)
    np.testing.assert_allclose(blend[4:8, 8:12].diagonal(), [1 / 8, 3 / 8, 5 / 8, 7 / 8])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: tiling((100, 300)), "does not fit"),
        (lambda: tiling((300, 300), 224, 224), "overlap"),
        (lambda: tiling((300, 300), 224, -1), "overlap"),
        (lambda: Tiles((300, 224), 224, (0,), (0,)), "cover 300 pixels"),
        (lambda: Tiles((672, 224), 224, (0, 448), (0,)), "gaps"),
        (lambda: tiling((227, 224)).blend_rows(56), "whole cells"),
        (lambda: tiling((224, 224)).cut(np.zeros((5, 5), np.uint8)), "frame"),
    ],
)
def test_nonsense_is_refused(make: object, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()  # type: ignore[operator]


def test_a_layout_is_read_as_it_was_written() -> None:
    """A trunk keeps it in its metadata; anything else is refused."""
    tiles = tiling((30, 47), 20, 5)
    assert Tiles.read(tiles.to_json()) == tiles
    with pytest.raises(ValueError, match="not a layout of tiles"):
        Tiles.read('{"frame": [30, 47]}')


def test_cells_of_a_mosaic_begin_where_their_tile_has_them() -> None:
    """Two tiles of 8 that begin at 0 and 4: cells of 4 pixels along the rows, of 2 along the columns."""
    rows, columns = Tiles((12, 8), 8, (0, 4), (0,)).edges((2, 4))
    assert (rows.tolist(), columns.tolist()) == ([0, 4, 4, 8], [0, 2, 4, 6])
