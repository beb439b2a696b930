"""A mosaic of tiles taken apart and put together again, so that no neighbourhood reaches into another tile.

Taps of a tiled trunk lie tile beside tile (`edge.core.tiles`). Cells that touch across a seam of the mosaic are no
neighbours on the part, so windows, averages and matches are made tile by tile: the mosaic's tiles become a batch.
Without tiles there is one, the whole map, and nothing moves.
"""

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Grid
from plugins.graph import Graph, Value

__all__ = ["emit_join", "emit_split", "join", "layout", "split", "stacked", "stepped", "tile_grid"]


def layout(grid: Grid) -> tuple[int, int]:
    """How many tiles lie down and across: (1, 1) without tiles."""
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


def stacked(maps: NDArray[np.floating], grid: Grid) -> NDArray[np.floating]:
    """A mosaic (n, c, H, W) with its tiles one under the other: (n, c, tiles * h, w)."""
    tiles = split(maps, grid)
    count = len(tiles) // len(maps)
    under = tiles.reshape(len(maps), count, *tiles.shape[1:]).swapaxes(1, 2)
    return under.reshape(len(maps), tiles.shape[1], count * tiles.shape[2], tiles.shape[3])


def join(raw: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Distances per tile (n * tiles, h, w) to the mosaic (n, H, W)."""
    (down, across), (_, h, w) = layout(grid), raw.shape
    return raw.reshape(-1, down, across, h, w).transpose(0, 1, 3, 2, 4).reshape(-1, down * h, across * w)


def stepped(index: NDArray[np.int64], step: int, period: int) -> NDArray[np.int64]:
    """Rows or columns of a mosaic, `step` further on but held within their own tile of `period` cells."""
    first = index // period * period
    return np.clip(index + step, first, first + period - 1)


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
