"""The way from a frame to a research model's input, resize and centre crop, and the way back for its maps.

Ref: torch's bilinear interpolation with half-pixel centres, with antialiasing where asked
(aten/src/ATen/native/cpu/UpSampleKernel.cpp); torchvision's Resize and CenterCrop.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from plugins.detectors.common.smoothing import upsampling_matrix

__all__ = ["Framing"]


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

    def back(self, axis: int) -> NDArray[np.float64]:
        """Draw one axis of a map of the input in the frame: (frame pixels, input pixels). Beyond the crop the map's
        border is repeated."""
        count, resized = self.size[axis], (self.resize or self.frame)[axis]
        first = round((resized - count) / 2)
        matrix = upsampling_matrix(resized, self.frame[axis])
        seen = matrix[:, first : first + count].copy()
        seen[:, 0] += matrix[:, :first].sum(axis=1)
        seen[:, -1] += matrix[:, first + count :].sum(axis=1)
        return seen
