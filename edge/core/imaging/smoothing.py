"""A picture smoothed against the noise of its camera, before anything is learnt from it or scored."""

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["smooth"]


def smooth(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Average each pixel with its neighbours, by the weights 1, 2, 1 across and down. rgb: (h, w, 3).

    The border's pixels are repeated beyond it. Of uint8 the sum is exact, and halves are rounded up.
    """
    return np.asarray(cv2.GaussianBlur(rgb, (3, 3), 0, borderType=cv2.BORDER_REPLICATE), rgb.dtype)
