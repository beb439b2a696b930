"""Runs a trunk on a large frame tile by tile: the memory of one tile, and no work for tiles without contact.

The trunk runs on one tile after the other, so memory does not grow with the frame, and a tile's features do not depend
on which others run. They are placed next to each other in the maps that the head reads (`edge.core.imaging.tiles`).

A tile that no nominal press touches shows free gel on every sound press. It is skipped where a press looks like the
free gel; the features of the free gel, computed once, are used instead. Where any few pixels differ by more than noise
and drifting light make them, the tile is run. What differs by less is not scored: specks, scratches, ripples and
imprints that did raised a score to the limit at most.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from edge.core.contact.mask import squared_distance
from edge.core.imaging.tiles import Tiles

__all__ = ["FREE_LEVELS", "FreeGel", "TileRunner", "TiledMaps", "most_typical", "untouched_tiles"]

# A tile looks like the free gel where no place differs by more beyond the noise. Of real tiles of free gel, smoothed as
# for a fit, none did, and of simulated ones 3 in 100; of damage beyond the limit of PaDiM or SPADE all but 1 in 100.
FREE_LEVELS = 6.5

# A place: a scratch of one pixel, smoothed, is three pixels wide. Means of larger places hide it in the noise.
_PLACE = (3, 3)

# Noise is what remains of a picture without its means over so many pixels: texture of the gel is coarser.
_COARSE = (9, 9)

# Side in pixels of the blocks by which pictures of the free gel are compared with their mean.
BLOCK_SIDE = 8


class TileRunner:
    """A trunk's session bound to one tile. maps: tap to its mosaic's shape (channels, h, w)."""

    def __init__(
        self, session: ort.InferenceSession, tiles: Tiles, maps: Mapping[str, tuple[int, int, int]]
    ) -> None:
        self.tiles, self.maps = tiles, maps
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
        """The features of one tile of a frame (h, w, 3), written to its place in the mosaics (channels, h, w)."""
        row, column = self.tiles.places[index]
        side = self.tiles.size
        self._tile[0] = frame[row : row + side, column : column + side]
        self._session.run_with_iobinding(self._io)
        for tap, tile_maps in self._found.items():
            into[tap][self.place(tap, index)] = tile_maps[0]

    def mosaics(self, frames: int, free: "FreeGel | None") -> "TiledMaps":
        """Make the mosaics of so many frames."""
        return TiledMaps(self, frames, free)

    def place(self, tap: str, index: int) -> tuple[slice, slice, slice]:
        """A tile's place in a tap's mosaic."""
        (row, column), (h, w) = divmod(index, len(self.tiles.columns)), self._cells[tap]
        return slice(None), slice(row * h, (row + 1) * h), slice(column * w, (column + 1) * w)


class FreeGel:
    """The trunk's features of the free gel, computed once, for tiles where a press shows free gel.

    rgb: uint8 (h, w, 3) of the region. untouched: the tiles that may be skipped, row by row.
    """

    def __init__(self, runner: TileRunner, rgb: NDArray[np.uint8], untouched: Sequence[int]) -> None:
        self.untouched = frozenset(untouched)
        self._runner, self._rgb = runner, rgb
        self._most = FREE_LEVELS**2 + 2 * _estimate_noise(rgb)
        self._maps = {tap: np.zeros(shape, np.float32) for tap, shape in runner.maps.items()}
        for index in sorted(self.untouched):
            runner.run(rgb, index, self._maps)

    def matching(self, frame: NDArray[np.uint8]) -> frozenset[int]:
        """The untouched tiles in which a frame, uint8 (h, w, 3), looks like the free gel."""
        return frozenset(index for index in self.untouched if self._is_free(frame, index))

    def _is_free(self, frame: NDArray[np.uint8], index: int) -> bool:
        (row, column), side = self._runner.tiles.places[index], self._runner.tiles.size
        place = slice(row, row + side), slice(column, column + side)
        difference = cv2.absdiff(frame[place], self._rgb[place]).astype(np.float32)
        return bool(cv2.blur(squared_distance(difference), _PLACE).max() <= self._most)

    def paste(self, index: int, into: Mapping[str, NDArray[np.float32]]) -> None:
        """Copy the free gel's features of a tile to its place in the mosaics."""
        for tap, mosaic in into.items():
            place = self._runner.place(tap, index)
            mosaic[place] = self._maps[tap][place]


class TiledMaps:
    """The mosaics of n frames, updated press by press. free: None where every tile is run.

    arrays: tap to float32 (n, channels, h, w), which a head may read in place.
    """

    def __init__(self, runner: TileRunner, frames: int, free: FreeGel | None = None) -> None:
        self.arrays = {tap: np.zeros((frames, *shape), np.float32) for tap, shape in runner.maps.items()}
        self._runner, self._free = runner, free
        # The tiles of each frame's mosaic that hold the free gel's features already.
        self._pasted: list[frozenset[int]] = [frozenset()] * frames

    def show(self, frames: NDArray[np.uint8]) -> None:
        """Update the mosaics to these frames, uint8 (n, h, w, 3)."""
        for number, frame in enumerate(frames):
            mosaics = {tap: array[number] for tap, array in self.arrays.items()}
            matching = frozenset() if self._free is None else self._free.matching(frame)
            self._pasted[number] &= matching  # the others are written over, and a run may fail
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
    """Return the frame of the free gel nearest to the mean; it keeps the noise of a single frame.

    frames: uint8 (m, h, w, 3).
    """
    blocks = np.stack([_blocks(frame) for frame in frames])
    distance = np.square(blocks - blocks.mean(axis=0)).sum(axis=(1, 2, 3))
    chosen: NDArray[np.uint8] = np.ascontiguousarray(frames[int(distance.argmin())])
    return chosen


def _blocks(frame: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Means over squares of 8 pixels, at the right and bottom over the remaining pixels: float32 (h/8, w/8, 3)."""
    h, w = frame.shape[:2]
    more = (-h % BLOCK_SIDE, -w % BLOCK_SIDE)
    padded = frame if more == (0, 0) else np.pad(frame, ((0, more[0]), (0, more[1]), (0, 0)), mode="edge")
    size = (padded.shape[1] // BLOCK_SIDE, padded.shape[0] // BLOCK_SIDE)
    # In float32: an 8-bit mean would round half a level away.
    return np.asarray(cv2.resize(padded.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _estimate_noise(rgb: NDArray[np.uint8]) -> float:
    """Estimate by how much two pictures of the free gel differ in a pixel, levels squared, from one of them."""
    picture = rgb.astype(np.float32)
    detail = squared_distance(picture - cv2.blur(picture, _COARSE))
    return 2 * float(np.median(cv2.blur(detail, _COARSE)))
