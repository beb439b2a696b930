"""The steps from a frame to a network's input, as data, as an ONNX graph, and in NumPy as their reference.

    frame - background -> / 255 -> + offset -> resize -> crop -> (x - mean) / std -> copies

Encoders that were trained on differences from the untouched gel have its picture inside the graph, so a bundle of such
a trunk belongs to one sensor. Encoders that were trained on two frames of a film get the one settled frame twice: while
the gateway scores a press, nothing moves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from edge.core.arrays import F64, U8
from edge.core.errors import ConfigError
from plugins.onnx_builder import Graph, Value

__all__ = ["IMAGENET", "InputSteps", "apply_steps", "cubic_matrix", "input_planes", "linear_matrix"]


@dataclass(frozen=True)
class InputSteps:
    """What is done to a frame, uint8 RGB (h, w, 3)."""

    mean: tuple[float, float, float]
    """The mean of RGB in 0..1, after the steps before it."""
    std: tuple[float, float, float]
    """The deviation of RGB in 0..1, likewise."""
    size: tuple[int, int] | None = None
    """(h, w) to resize to, linear; None keeps the frame's."""
    crop: tuple[int, int] | None = None
    """(h, w) of the middle that remains after that; None keeps all."""
    background: U8 | None = None
    """uint8 (h, w, 3), the picture without contact, which is subtracted."""
    offset: float = 0.0
    """It is added after the subtraction, with the result limited to 0..1."""
    copies: int = 1
    """How often the three channels are given."""
    is_antialiased: bool = True
    """Whether a smaller picture averages all pixels, as most training programs do."""

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.mean, *self.std, self.offset]).all() and min(self.std) > 0):
            raise ConfigError(
                f"mean {self.mean}, std {self.std} and offset {self.offset} cannot scale a picture"
            )
        if self.copies < 1 or (self.size is not None and min(self.size) < 1):
            raise ConfigError(f"a network's input has a size and a copy, found {self.size} and {self.copies}")

    @property
    def words(self) -> str:
        """The steps in order, for a graph's metadata."""
        steps = ["x/255"] if self.background is None else ["(x-background)/255"]
        if self.background is not None and self.offset:
            steps.append(f"+{self.offset:g}, limited to 0..1")
        if self.size is not None:
            plainly = "" if self.is_antialiased else " without antialiasing"
            steps.append(f"resize {self.size[0]}x{self.size[1]}{plainly}")
        if self.crop is not None:
            steps.append(f"crop {self.crop[0]}x{self.crop[1]}")
        steps.append(f"-{_write_tuple(self.mean)}, /{_write_tuple(self.std)}")
        if self.copies > 1:
            steps.append(f"the settled frame {self.copies} times")
        return "; ".join(steps)

    def resampling(self, frame: tuple[int, int]) -> tuple[F64, F64] | None:
        """Give the matrices (h', h) and (w', w) of resize and crop; None where the frame stays as it is.

        Fixed matrices: runtimes differ in how they resize with antialiasing at the border.
        """
        size = self.size or frame
        crop = self.crop or size
        if crop == size == frame:
            return None
        rows, columns = (
            linear_matrix(source, target, self.is_antialiased)[round((target - kept) / 2) :][:kept]
            for source, target, kept in zip(frame, size, crop, strict=True)
        )
        return rows, columns


IMAGENET = InputSteps((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
"""The usual normalisation of ImageNet-trained networks (torchvision's published transforms)."""


def input_planes(graph: Graph, steps: InputSteps, frame: tuple[int, int] | None = None) -> Value:
    """Add the input `frames` uint8 (n, h, w, 3) and the steps; the value is float32 (n, 3 x copies, h', w').

    frame: (h, w) of the frames where it is fixed. Errors: ConfigError for a background of another size.
    """
    h, w = frame or ("h", "w")
    x = graph.op("Cast", graph.input("frames", ("n", h, w, 3), "uint8"), to=1)
    if steps.background is not None:
        if frame is not None and steps.background.shape != (*frame, 3):
            raise ConfigError(
                f"the background is {steps.background.shape[:2]}, frames are {frame} (h, w); give a picture of the "
                "free gel from the same sensor, cut to the same region"
            )
        x = graph.op("Sub", x, graph.constant(steps.background.astype(np.float32)))
    x = graph.transpose(x, 0, 3, 1, 2)
    if steps.background is not None and steps.offset:
        x = graph.op("Mul", x, graph.scalar(1 / 255))
        x = graph.op("Clip", graph.op("Add", x, graph.scalar(steps.offset)), graph.scalar(0), graph.scalar(1))
        scale = 1 / np.asarray(steps.std, np.float64)
    else:
        scale = 1 / (255 * np.asarray(steps.std, np.float64))
    shift = -np.asarray(steps.mean, np.float64) / np.asarray(steps.std, np.float64)
    if frame is None and (steps.size or steps.crop):
        raise ConfigError(f"frames are resized to {steps.size} from one fixed size; state the region")
    if frame is not None and (matrices := steps.resampling(frame)) is not None:
        x = graph.between(matrices[0], x, matrices[1])
    x = graph.op("Mul", x, graph.constant(scale.reshape(1, 3, 1, 1).astype(np.float32)))
    x = graph.op("Add", x, graph.constant(shift.reshape(1, 3, 1, 1).astype(np.float32)))
    return x if steps.copies == 1 else graph.op("Concat", *[x] * steps.copies, axis=1)


def apply_steps(steps: InputSteps, frames: U8) -> F64:
    """Do the same in NumPy: uint8 (n, h, w, 3) to float64 (n, 3 x copies, h', w')."""
    x = frames.astype(np.float64)
    if steps.background is not None:
        x = x - steps.background
    x = x / 255
    if steps.background is not None and steps.offset:
        x = np.clip(x + steps.offset, 0, 1)
    if (matrices := steps.resampling((frames.shape[1], frames.shape[2]))) is not None:
        x = np.einsum("yh,nhwc,xw->nyxc", matrices[0], x, matrices[1], optimize=True)
    x = (x - np.asarray(steps.mean)) / np.asarray(steps.std)
    planes = np.ascontiguousarray(x.transpose(0, 3, 1, 2))
    return np.concatenate([planes] * steps.copies, axis=1)


def linear_matrix(source: int, target: int, is_antialiased: bool = True) -> F64:
    """Linear resampling as a matrix (target, source)."""
    return _resampling(source, target, lambda x: np.clip(1 - np.abs(x), 0, None), is_antialiased)


def cubic_matrix(source: int, target: int) -> F64:
    """Bicubic resampling (a = -1/2) with antialiasing as a matrix (target, source)."""

    def kernel(x: F64) -> F64:
        x = np.abs(x)
        near = (1.5 * x - 2.5) * x**2 + 1
        far = ((-0.5 * x + 2.5) * x - 4) * x + 2
        return np.where(x < 1, near, np.where(x < 2, far, 0))

    return _resampling(source, target, kernel)


def _resampling(
    source: int,
    target: int,
    kernel: Callable[[F64], F64],
    is_antialiased: bool = True,
) -> F64:
    """Weigh input pixels by a kernel; rows sum to 1 at the border too.

    With antialiasing the kernel is widened to an output pixel where pixels become fewer.
    """
    scale = source / target
    centres = (np.arange(target) + 0.5) * scale - 0.5
    weights = kernel((np.arange(source) - centres[:, None]) / (max(scale, 1.0) if is_antialiased else 1.0))
    matrix: F64 = weights / weights.sum(axis=1, keepdims=True)
    return matrix


def _write_tuple(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
