"""Two graphs joined by buffers: the trunk writes its taps where the head reads them."""

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

if TYPE_CHECKING:
    from edge.model.tile_runner import TiledMaps

__all__ = ["FRAMES", "RELIEF_MAP", "SCORE", "SCORE_MAP", "Pipe", "Ran"]

FRAMES, SCORE_MAP, SCORE = "frames", "score_map", "score"
RELIEF_MAP = "relief_map"
"""What `score_map` shows of missing relief alone; heads that check for it give it."""

Ran = tuple[Sequence[NDArray[np.float32]], float, float]
"""The outputs, each of n frames, and the milliseconds in trunk and head."""


class Pipe:
    """The two graphs joined by buffers for a fixed number of frames. mosaics: set for a tiled trunk."""

    def __init__(
        self,
        trunk: ort.InferenceSession | None,
        head: ort.InferenceSession,
        taps: Mapping[str, tuple[int, int, int]],
        bank: Mapping[str, ort.OrtValue],
        shape: tuple[int, ...],
        mosaics: "TiledMaps | None" = None,
        features: Mapping[str, ort.OrtValue] | None = None,
        outputs: Sequence[str] = (SCORE_MAP, SCORE),
    ) -> None:
        self.size = shape[0]
        self.features: dict[str, ort.OrtValue] = {**(features or {})}
        """By tap: of this pipe's own runs, or given, of another one's."""
        self._has_features = False
        self._mosaics = mosaics
        # onnxruntime reads this array in place: so a frame that is written into it is bound.
        self._frames = np.zeros(shape, np.uint8)
        frames = ort.OrtValue.ortvalue_from_numpy(self._frames)
        self._trunk, self._head = trunk, head
        self._head_io = head.io_binding()
        if trunk is None:
            self._head_io.bind_ortvalue_input(FRAMES, frames)
        elif features is not None:
            pass  # another pipe fills them
        elif mosaics is not None:
            arrays = mosaics.arrays.items()
            self.features = {name: ort.OrtValue.ortvalue_from_numpy(array) for name, array in arrays}
        else:
            self._trunk_io = trunk.io_binding()
            self._trunk_io.bind_ortvalue_input(FRAMES, frames)
            for name, tap in taps.items():
                buffer = ort.OrtValue.ortvalue_from_shape_and_type((self.size, *tap), np.float32, "cpu")
                self._trunk_io.bind_ortvalue_output(name, buffer)
                self.features[name] = buffer
        for name in taps:
            self._head_io.bind_ortvalue_input(name, self.features[name])
        for name, array in bank.items():
            self._head_io.bind_ortvalue_input(name, array)
        for name in outputs:
            self._head_io.bind_output(name, "cpu")

    def run(self, frames: NDArray[np.uint8]) -> Ran:
        """Run both graphs."""
        start = time.perf_counter()
        self._has_features = False
        self._frames[...] = frames
        if self._mosaics is not None:
            self._mosaics.show(frames)
        elif self._trunk is not None:
            self._trunk.run_with_iobinding(self._trunk_io)
        self._has_features = self._trunk is not None
        trunk_ms = (time.perf_counter() - start) * 1e3
        outputs, _, head_ms = self.run_head()
        return outputs, trunk_ms, head_ms

    def run_head(self) -> Ran:
        """Run the head on the features that are there."""
        start = time.perf_counter()
        self._head.run_with_iobinding(self._head_io)
        end = time.perf_counter()
        # The runtime writes the next result into the same memory, so a copy is returned.
        outputs = [value.numpy().copy() for value in self._head_io.get_outputs()]
        return outputs, 0.0, (end - start) * 1e3

    def find_features(self, rgb: NDArray[np.uint8]) -> Mapping[str, ort.OrtValue] | None:
        """Return the features of this frame, uint8 (h, w, 3), where the last run was of it alone."""
        is_of_it = self._has_features and self.size == 1 and np.array_equal(self._frames[0], rgb)
        return self.features if is_of_it else None
