"""The picture of a press without the marks of its gel."""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View
from edge.core.imaging.region import Region

__all__ = ["without_marks"]

U8 = NDArray[np.uint8]


def without_marks(rgb: U8, change: View, size: tuple[int, int], region: Region) -> U8:
    """A picture with a change of the gel taken out, uint8 (h, w, 3).

    rgb: uint8 (h, w, 3) of `region`, in the picture of `size` (width, height). change: of `Marks`, float32 (h', w', 3)
    of the view of the complete picture, levels.
    """
    across, down = change.shape[1] / size[0], change.shape[0] / size[1]
    # From the centre of a pixel of the region to the place in the view.
    places = np.array(
        [[across, 0, (region.x + 0.5) * across - 0.5], [0, down, (region.y + 0.5) * down - 0.5]], np.float64
    )
    wide = cv2.warpAffine(
        change,
        places,
        (region.width, region.height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(np.clip(np.rint(rgb - wide), 0, 255), np.uint8)
