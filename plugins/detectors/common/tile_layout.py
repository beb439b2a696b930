"""A mosaic of tiles is split and joined again, so that no neighbourhood reaches into another tile.

Taps of a tiled trunk are a mosaic of tiles (`edge.core.imaging`). Cells on both sides of a seam of the mosaic are not
neighbours on the part, so windows, averages and matches are made tile by tile: the mosaic's tiles become a batch.
Without tiles the map is the only tile and stays as it is.
"""

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64
from edge.core.detector import Grid
from plugins.onnx_builder import Graph, Value

__all__ = [
    "cell_blocks",
    "emit_join",
    "emit_split",
    "join",
    "layout",
    "neighbourhood",
    "split",
    "stepped",
    "tile_grid",
]


def layout(grid: Grid) -> tuple[int, int]:
    """The number of tiles down and across: (1, 1) without tiles."""
    return (1, 1) if grid.tiles is None else (len(grid.tiles.rows), len(grid.tiles.columns))


def tile_grid(grid: Grid) -> Grid:
    """The geometry of one tile."""
    if grid.tiles is None:
        return grid
    down, across = layout(grid)
    taps = {tap: (c, h // down, w // across) for tap, (c, h, w) in grid.taps.items()}
    return Grid((grid.tiles.size, grid.tiles.size), taps, grid.pixels_per_mm)


def split(maps: NDArray[np.floating], grid: Grid) -> NDArray[np.floating]:
    """A mosaic (n, c, H, W) to its tiles (n * tiles, c, h, w), row by row."""
    (down, across), (n, c, height, width) = layout(grid), maps.shape
    parts = maps.reshape(n, c, down, height // down, across, width // across).transpose(0, 2, 4, 1, 3, 5)
    return parts.reshape(n * down * across, c, height // down, width // across)


def join(raw: F64, grid: Grid) -> F64:
    """Distances per tile (n * tiles, h, w) to the mosaic (n, H, W)."""
    (down, across), (_, h, w) = layout(grid), raw.shape
    return raw.reshape(-1, down, across, h, w).transpose(0, 1, 3, 2, 4).reshape(-1, down * h, across * w)


def stepped(index: NDArray[np.int64], step: int, period: int) -> NDArray[np.int64]:
    """Rows or columns of a mosaic, `step` further but clamped to their own tile of `period` cells."""
    first = index // period * period
    return np.clip(index + step, first, first + period - 1)


def neighbourhood(
    cells: NDArray[np.int64], shape: tuple[int, int], tiles: tuple[int, int], reach: int
) -> NDArray[np.int64]:
    """The square of cells around each of flat `cells` (m,) of a mosaic of `shape`: (m, (2 * reach + 1)^2).

    A cell beyond the border of a tile is replaced by the one at it. tiles: their number down and across.
    """
    (height, width), (down, across) = shape, tiles
    steps = range(-reach, reach + 1)
    rows = [stepped(cells // width, step, height // down) for step in steps]
    columns = [stepped(cells % width, step, width // across) for step in steps]
    return np.stack([row * width + column for row in rows for column in columns], axis=1)


def cell_blocks(shape: tuple[int, int], tiles: tuple[int, int], side: int) -> NDArray[np.int64]:
    """The flat cells of each block of side x side cells, (blocks, side^2): none reaches into another tile.

    Where the blocks do not fill a tile its last cells are repeated.
    """
    axes = []
    for size, count in zip(shape, tiles, strict=True):
        period = size // count
        inside = np.minimum(np.arange(0, period, side)[:, None] + np.arange(side), period - 1)
        axes.append((np.arange(count)[:, None, None] * period + inside).reshape(-1, side))
    rows, columns = axes
    table: NDArray[np.int64] = rows[:, None, :, None] * shape[1] + columns[None, :, None, :]
    return table.reshape(-1, side * side)


def emit_split(graph: Graph, maps: Value, shape: tuple[int, int, int], grid: Grid) -> Value:
    """`split` in a graph. shape: (c, H, W) of the mosaic."""
    if grid.tiles is None:
        return maps
    (down, across), (c, height, width) = layout(grid), shape
    h, w = height // down, width // across
    parts = graph.transpose(graph.reshape(maps, -1, c, down, h, across, w), 0, 2, 4, 1, 3, 5)
    return graph.reshape(parts, -1, c, h, w)


def emit_join(graph: Graph, raw: Value, cells: tuple[int, int], grid: Grid) -> Value:
    """`join` in a graph. cells: (h, w) of one tile."""
    if grid.tiles is None:
        return raw
    (down, across), (h, w) = layout(grid), cells
    parts = graph.transpose(graph.reshape(raw, -1, down, across, h, w), 0, 1, 3, 2, 4)
    return graph.reshape(parts, -1, down * h, across * w)
