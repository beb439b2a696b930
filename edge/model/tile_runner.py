"""A trunk that sees a large frame tile by tile: one tile's memory, and no work where the gel is free.

The tiles of a press go through the trunk one after the other, so that memory does not grow with the frame and a tile's
features do not depend on which others are looked at. They are laid tile beside tile into the maps that the head reads
(`edge.core.imaging.tiles`).

A tile that no nominal press touches holds the untouched gel on every sound press. It is skipped on a press that looks
like the free gel there: the features of the free gel, computed once, stand in. A press that differs there is looked at
in full, so nothing that touches the gel goes unseen, wherever it lies.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from edge.core.contact.mask import TOUCH_LEVELS
from edge.core.imaging.tiles import Tiles

__all__ = ["FREE_LEVELS", "FreeGel", "TileRunner", "TiledMaps", "most_typical", "untouched_tiles"]

# A tile looks like the free gel when no block of it differs by more: half of what counts as touch, above the noise.
FREE_LEVELS = TOUCH_LEVELS / 2

# Side in pixels of the blocks that are compared: 8 of 1280x720 are one pixel of the view in which touch is found.
BLOCK_SIDE = 8


class TileRunner:
    """A trunk's session bound to one tile. maps: tap to its mosaic's shape (channels, h, w)."""

    def __init__(
        self, session: ort.InferenceSession, tiles: Tiles, maps: Mapping[str, tuple[int, int, int]]
    ) -> None:
        self.tiles = tiles
        self.runs = 0
        down, across = len(tiles.rows), len(tiles.columns)
        self._cells = {tap: (h // down, w // across) for tap, (_, h, w) in maps.items()}
        self._session, self._io = session, session.io_binding()
        # onnxruntime reads and writes these arrays in place.
        self._tile = np.zeros((1, tiles.size, tiles.size, 3), np.uint8)
        self._found = {
            tap: np.zeros((1, maps[tap][0], h, w), np.float32) for tap, (h, w) in self._cells.items()
        }
        self._io.bind_ortvalue_input("frames", ort.OrtValue.ortvalue_from_numpy(self._tile))
        for tap, array in self._found.items():
            self._io.bind_ortvalue_output(tap, ort.OrtValue.ortvalue_from_numpy(array))

    def run(self, frame: NDArray[np.uint8], index: int, into: Mapping[str, NDArray[np.float32]]) -> None:
        """The features of one tile of a frame (h, w, 3), laid into its place of the mosaics (channels, h, w)."""
        row, column = self.tiles.places[index]
        side = self.tiles.size
        self._tile[0] = frame[row : row + side, column : column + side]
        self._session.run_with_iobinding(self._io)
        self.runs += 1
        for tap, found in self._found.items():
            into[tap][self.place(tap, index)] = found[0]

    def place(self, tap: str, index: int) -> tuple[slice, slice, slice]:
        """Where a tile lies in a tap's mosaic."""
        (row, column), (h, w) = divmod(index, len(self.tiles.columns)), self._cells[tap]
        return slice(None), slice(row * h, (row + 1) * h), slice(column * w, (column + 1) * w)


class FreeGel:
    """What stands in where a press is free gel: the trunk's features of it, run once.

    rgb: uint8 (h, w, 3) of the region. untouched: the tiles that may be skipped, row by row.
    """

    def __init__(
        self,
        runner: TileRunner,
        maps: Mapping[str, tuple[int, int, int]],
        rgb: NDArray[np.uint8],
        untouched: Sequence[int],
    ) -> None:
        self.untouched = frozenset(untouched)
        self._runner, self._blocks = runner, _blocks(rgb)
        self._maps = {tap: np.zeros(shape, np.float32) for tap, shape in maps.items()}
        for index in sorted(self.untouched):
            runner.run(rgb, index, self._maps)

    def matching(self, frame: NDArray[np.uint8]) -> frozenset[int]:
        """The untouched tiles in which a frame, uint8 (h, w, 3), looks like the free gel."""
        difference = _blocks(frame) - self._blocks
        is_far = np.einsum("hwc,hwc->hw", difference, difference) > FREE_LEVELS**2
        tiles = self._runner.tiles
        return frozenset(i for i in self.untouched if not is_far[_reach(tiles.places[i], tiles.size)].any())

    def paste(self, index: int, into: Mapping[str, NDArray[np.float32]]) -> None:
        """The free gel's features of a tile, laid into its place of the mosaics."""
        for tap, mosaic in into.items():
            place = self._runner.place(tap, index)
            mosaic[place] = self._maps[tap][place]


class TiledMaps:
    """The mosaics of n frames, brought up to date press by press. free: None where every tile is run.

    arrays: tap to float32 (n, channels, h, w), which a head may read in place.
    """

    def __init__(
        self,
        runner: TileRunner,
        maps: Mapping[str, tuple[int, int, int]],
        frames: int,
        free: FreeGel | None = None,
    ) -> None:
        self.arrays = {tap: np.zeros((frames, *shape), np.float32) for tap, shape in maps.items()}
        self._runner, self._free = runner, free
        # The tiles of each frame's mosaic that hold the free gel's features already.
        self._pasted: list[frozenset[int]] = [frozenset()] * frames

    def show(self, frames: NDArray[np.uint8]) -> None:
        """Bring the mosaics to these frames, uint8 (n, h, w, 3)."""
        for number, frame in enumerate(frames):
            mosaics = {tap: array[number] for tap, array in self.arrays.items()}
            matching = frozenset() if self._free is None else self._free.matching(frame)
            for index in range(len(self._runner.tiles)):
                if index not in matching:
                    self._runner.run(frame, index, mosaics)
                elif self._free is not None and index not in self._pasted[number]:
                    self._free.paste(index, mosaics)
            self._pasted[number] = matching


def untouched_tiles(tiles: Tiles, touched: NDArray[np.bool_]) -> tuple[int, ...]:
    """The tiles in which no pixel is touched, row by row. touched: bool (h, w) of the frame."""
    side = tiles.size
    return tuple(
        index
        for index, (row, column) in enumerate(tiles.places)
        if not touched[row : row + side, column : column + side].any()
    )


def most_typical(frames: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Of frames of the free gel, uint8 (m, h, w, 3), the one nearest to their mean: it carries the noise of one."""
    blocks = np.stack([_blocks(frame) for frame in frames])
    distance = np.square(blocks - blocks.mean(axis=0)).sum(axis=(1, 2, 3))
    chosen: NDArray[np.uint8] = np.ascontiguousarray(frames[int(distance.argmin())])
    return chosen


def _blocks(frame: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Means over squares of 8 pixels, those at the right and bottom over what is left: float32 (h/8, w/8, 3)."""
    h, w = frame.shape[:2]
    more = (-h % BLOCK_SIDE, -w % BLOCK_SIDE)
    whole = frame if more == (0, 0) else np.pad(frame, ((0, more[0]), (0, more[1]), (0, 0)), mode="edge")
    size = (whole.shape[1] // BLOCK_SIDE, whole.shape[0] // BLOCK_SIDE)
    # In float32: an 8-bit mean would round half a level away.
    return np.asarray(cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _reach(place: tuple[int, int], side: int) -> tuple[slice, slice]:
    """The blocks that a tile lies on, in part too."""
    row, column = place
    return (
        slice(row // BLOCK_SIDE, -(-(row + side) // BLOCK_SIDE)),
        slice(column // BLOCK_SIDE, -(-(column + side) // BLOCK_SIDE)),
    )
