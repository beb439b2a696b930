"""Tiles: a large frame cut into overlapping squares, and grids of distances joined without seams.

The last tile of an axis is shifted back to the border, so nothing is padded or left out. Tiles form a regular grid, so
their feature maps form one mosaic, and joining them is one matrix per axis: the frame's grid is `rows @ mosaic @
columns.T`. Raw distances are blended, before any blur.

A tile's weight is 1 where no neighbour overlaps it and decreases linearly where one does, never to zero. After division
the weights at every cell sum to 1.
"""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["FLOOR", "TILES_KEY", "Tiles", "tiling"]

# The entry in a trunk's metadata that holds its layout, as `Tiles.to_json` gives it.
TILES_KEY = "gelgate_tiles"

# The weight at the very edge of a tile that a neighbour overlaps. Windows that reach zero leave blind seams.
FLOOR = 0.05


@dataclass(frozen=True)
class Tiles:
    """Squares over a frame. rows, columns: the first pixel of each tile along each axis, rising."""

    frame: tuple[int, int]
    """(h, w)."""
    size: int
    rows: tuple[int, ...]
    columns: tuple[int, ...]

    def __post_init__(self) -> None:
        for axis, starts, pixels in (
            ("rows", self.rows, self.frame[0]),
            ("columns", self.columns, self.frame[1]),
        ):
            steps = np.diff(starts)
            if not starts or starts[0] != 0 or starts[-1] != pixels - self.size:
                raise ValueError(
                    f"tiles of {self.size} cover {pixels} pixels from border to border, {axis} {starts}"
                )
            if (steps < 1).any() or (steps > self.size).any():
                raise ValueError(f"tiles of {self.size} leave gaps or repeat: {axis} {starts}")

    def __len__(self) -> int:
        return len(self.rows) * len(self.columns)

    @property
    def places(self) -> tuple[tuple[int, int], ...]:
        """(first row, first column) of every tile, row by row."""
        return tuple((row, column) for row in self.rows for column in self.columns)

    def cut(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The tiles of one frame (h, w, ...): (tiles, size, size, ...), row by row."""
        if frame.shape[:2] != self.frame:
            raise ValueError(f"these tiles are of a frame {self.frame} (h, w), found {frame.shape[:2]}")
        return np.stack([frame[r : r + self.size, c : c + self.size] for r, c in self.places])

    def blend_rows(self, cells: int) -> NDArray[np.float64]:
        """Give the weights from the mosaic's rows to the frame's: float64 (frame cells, tiles * cells), rows sum to 1.

        cells: rows of one tile's grid. Errors: ValueError when the tiles do not start on whole cells.
        """
        return _blend(self.rows, self.size, self.frame[0], cells)

    def blend_columns(self, cells: int) -> NDArray[np.float64]:
        """Give the weights from the mosaic's columns to the frame's, as `blend_rows`."""
        return _blend(self.columns, self.size, self.frame[1], cells)

    def to_json(self) -> str:
        """Write the layout as JSON, for a trunk's metadata."""
        return json.dumps(
            {"frame": self.frame, "size": self.size, "rows": self.rows, "columns": self.columns}
        )

    @classmethod
    def read(cls, text: str) -> "Tiles":
        """Read the text of `to_json`. Errors: ValueError for anything else."""
        try:
            layout = json.loads(text)
            h, w = layout["frame"]
            return cls((h, w), layout["size"], tuple(layout["rows"]), tuple(layout["columns"]))
        except (KeyError, TypeError, json.JSONDecodeError) as error:
            raise ValueError(f"not a layout of tiles: {text[:80]}") from error

    def edges(self, cells: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """First pixel of every row and column of the mosaic, for one tile's grid of (rows, columns) cells."""
        return _edges(self.rows, self.size, cells[0]), _edges(self.columns, self.size, cells[1])


def tiling(frame: tuple[int, int], size: int = 224, overlap: int = 56) -> Tiles:
    """Tiles of `size` over `frame` (h, w), with at least `overlap` pixels in common, the last one shifted to the
    border.

    The defaults are the seed paper's. Errors: ValueError when the frame is smaller than a tile, or the overlap is not
    smaller.
    """
    if min(frame) < size:
        raise ValueError(
            f"a tile of {size} does not fit into a frame of {frame} (h, w); inspect it without tiles"
        )
    if not 0 <= overlap < size:
        raise ValueError(f"an overlap is in 0..{size - 1} for tiles of {size}, found {overlap}")
    rows, columns = ((*range(0, pixels - size, size - overlap), pixels - size) for pixels in frame)
    return Tiles(frame, size, rows, columns)


def _edges(starts: tuple[int, ...], size: int, cells: int) -> NDArray[np.float64]:
    within = np.arange(cells) * (size / cells)
    edges: NDArray[np.float64] = (np.array(starts)[:, None] + within).ravel()
    return edges


def _blend(starts: tuple[int, ...], size: int, pixels: int, cells: int) -> NDArray[np.float64]:
    if size % cells or any(start % (size // cells) for start in starts):
        raise ValueError(
            f"tiles of {size} pixels at {starts} do not start on whole cells of a grid of {cells}; choose a size and "
            "an overlap that its stride divides"
        )
    stride = size // cells
    weights = np.zeros((pixels // stride, len(starts) * cells))
    for index, start in enumerate(starts):
        before = starts[index - 1] + size - start if index else 0
        after = start + size - starts[index + 1] if index + 1 < len(starts) else 0
        first = start // stride
        window = _window(cells, before / stride, after / stride)
        weights[np.arange(first, first + cells), np.arange(index * cells, (index + 1) * cells)] = window
    blend: NDArray[np.float64] = weights / weights.sum(axis=1, keepdims=True)
    return blend


def _window(cells: int, before: float, after: float) -> NDArray[np.float64]:
    """Weights of one tile along one axis, float64 (cells,). before, after: cells in common with the neighbours."""
    centres = np.arange(cells) + 0.5
    window = np.ones(cells)
    if before:
        window = np.minimum(window, np.clip(centres / before, FLOOR, 1))
    if after:
        window = np.minimum(window, np.clip((cells - centres) / after, FLOOR, 1))
    return window
