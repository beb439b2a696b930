"""The steps between a frame and a research model's input, put into a trunk: resize, centre crop; and the way back.

Both are one matrix per axis. Ref: torch's bilinear interpolation with half-pixel centres, with antialiasing where asked
(aten/src/ATen/native/cpu/UpSampleKernel.cpp); torchvision's Resize and CenterCrop.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError

__all__ = ["Framing", "framed_trunk", "resizing_matrix"]


@dataclass(frozen=True)
class Framing:
    """From frames (h, w) to the model's input."""

    frame: tuple[int, int]
    resize: tuple[int, int] | None = None
    """(h, w) to resize to, None keeps the frame."""
    crop: tuple[int, int] | None = None
    """(h, w) of the middle that remains, None keeps all."""
    is_antialiased: bool = True

    def __post_init__(self) -> None:
        resized = self.resize or self.frame
        if min(*resized, *(self.crop or resized)) < 1 or max(resized) > 4096:
            raise ConfigError(
                f"a picture of {resized} and a crop of {self.crop} (h, w) cannot be a model's input"
            )
        if self.crop and (self.crop[0] > resized[0] or self.crop[1] > resized[1]):
            raise ConfigError(
                f"the model crops {self.crop} out of {resized} (h, w), which is smaller; give a larger --region"
            )

    @property
    def size(self) -> tuple[int, int]:
        """(h, w) of the model's input."""
        return self.crop or self.resize or self.frame

    @property
    def is_plain(self) -> bool:
        """True where the model sees the frame without resize and crop."""
        return self.size == self.frame and (self.resize or self.frame) == self.frame

    @property
    def seen(self) -> float:
        """The part of the frame that the model sees, 0 to 1."""
        resized = self.resize or self.frame
        return self.size[0] * self.size[1] / (resized[0] * resized[1])

    def matrix(self, axis: int) -> NDArray[np.float64]:
        """Map one axis from frame to input: (input pixels, frame pixels)."""
        resized = (self.resize or self.frame)[axis]
        first, count = self._first(axis), self.size[axis]
        return resizing_matrix(self.frame[axis], resized, self.is_antialiased)[first : first + count]

    def back(self, axis: int) -> NDArray[np.float64]:
        """Draw one axis of a map of the input in the frame: (frame pixels, input pixels). Beyond the crop the map's
        border is repeated."""
        pixels, count = self.frame[axis], self.size[axis]
        resized = (self.resize or self.frame)[axis]
        centre = np.clip((np.arange(pixels) + 0.5) * resized / pixels - 0.5 - self._first(axis), 0, count - 1)
        low = np.floor(centre).astype(np.int64)
        matrix = np.zeros((pixels, count))
        np.add.at(matrix, (np.arange(pixels), low), 1 - (centre - low))
        np.add.at(matrix, (np.arange(pixels), np.minimum(low + 1, count - 1)), centre - low)
        return matrix

    def _first(self, axis: int) -> int:
        resized = (self.resize or self.frame)[axis]
        return round((resized - self.size[axis]) / 2.0)


def resizing_matrix(pixels: int, onto: int, is_antialiased: bool) -> NDArray[np.float64]:
    """Resize one axis bilinearly, (onto, pixels); each row sums to 1. Antialiased: the triangle widens with the
    scale where the picture shrinks."""
    scale = pixels / onto
    if not is_antialiased or scale <= 1:
        centre = np.clip((np.arange(onto) + 0.5) * scale - 0.5, 0, pixels - 1)
        weights = np.clip(1 - np.abs(np.arange(pixels) - centre[:, None]), 0, None)
    else:
        centre = (np.arange(onto) + 0.5) * scale - 0.5
        weights = np.clip(1 - np.abs(np.arange(pixels) - centre[:, None]) / scale, 0, None)
    matrix: NDArray[np.float64] = weights / weights.sum(axis=1, keepdims=True)
    return matrix


def framed_trunk(trunk: bytes, framing: Framing) -> bytes:
    """A trunk that takes the frames of `framing` and shows the model its input. Imports onnx at use.

    Errors: ConfigError for a trunk that does not begin by turning `frames` into numbers.
    """
    if framing.is_plain:
        return trunk
    import onnx
    from onnx import helper, numpy_helper

    model = onnx.load_from_string(trunk)
    casts = [node for node in model.graph.node if "frames" in node.input]
    if len(casts) != 1 or casts[0].op_type != "Cast":
        raise ConfigError("the trunk reads its frames in several places, so no resize can be put before it")
    seen = casts[0].output[0]
    casts[0].output[0] = "framing/levels"
    rows = np.asarray(framing.matrix(0), np.float32)
    columns = np.ascontiguousarray(framing.matrix(1).T, np.float32)
    model.graph.initializer.append(numpy_helper.from_array(rows, "framing/rows"))
    model.graph.initializer.append(numpy_helper.from_array(columns, "framing/columns"))
    steps = [
        helper.make_node("Transpose", ["framing/levels"], ["framing/planes"], perm=[0, 3, 1, 2]),
        helper.make_node("MatMul", ["framing/rows", "framing/planes"], ["framing/down"]),
        helper.make_node("MatMul", ["framing/down", "framing/columns"], ["framing/across"]),
        helper.make_node("Transpose", ["framing/across"], [seen], perm=[0, 2, 3, 1]),
    ]
    at = list(model.graph.node).index(casts[0]) + 1
    nodes = list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend([*nodes[:at], *steps, *nodes[at:]])
    _fix_input(model, framing.frame)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def _fix_input(model: Any, frame: tuple[int, int]) -> None:
    dims = model.graph.input[0].type.tensor_type.shape.dim
    for dim, size in zip(dims[1:3], frame, strict=True):
        dim.Clear()
        dim.dim_value = size
