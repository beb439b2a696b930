"""How far the part reaches in a press, and how far it is expected to: what lies beyond both is the gel's."""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import touched_mask
from edge.core.contact.reference import Reference
from edge.core.contact.relief import Relief, ReliefOfReference
from edge.core.contact.settings import ContactSettings
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.region import Region

__all__ = ["find_expected_reach", "reach"]

U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# 0.5 mm of the 160x120 view around what is touched: a smooth contact fades out without relief. Relief is taken over a
# window of 1.1 mm, so it reaches as far by itself.
_AROUND: Final = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
# One point that is pressed shows relief in 25 cells or more; noise and faint specks show it in fewer.
_CLEAR: Final = np.ones((3, 3), np.uint8)
# Where half of the nominal presses have contact, a press without is missing something.
_EXPECTED_SHARE: Final = 0.5


def reach(touched: Mask, relief: Relief) -> Mask:
    """Find where the part touches the gel or bends it, bool (h, w) of the view.

    A burr beside the part shows relief there. A speck on the gel that nothing presses is much fainter.
    """
    rows, columns = touched.shape
    clear = cv2.morphologyEx(relief.mask.astype(np.uint8), cv2.MORPH_OPEN, _CLEAR)
    bent = cv2.resize(clear, (columns, rows), interpolation=cv2.INTER_NEAREST)
    return np.asarray(np.maximum(cv2.dilate(touched.astype(np.uint8), _AROUND), bent) > 0)


def find_expected_reach(
    presses: Sequence[U8],
    free: U8 | None,
    usual: NDArray[np.float32] | None,
    region: Region,
    size: tuple[int, int],
) -> Mask | None:
    """Find where nominal presses reach, bool (h, w) of the region; None where nothing is known of them.

    presses: nominal ones, uint8 (h, w, 3) of the region in a picture of `size` (width, height). free: the view of the
    free gel, uint8 (120, 160, 3). usual: the mean contact of nominal presses over the region, in cells. Either may be
    None.
    """
    expected = np.zeros((region.height, region.width), bool)
    if usual is not None:
        cells = (usual >= _EXPECTED_SHARE * usual.max()).astype(np.uint8)
        expected |= _resize(cells, expected.shape) > 0
    if free is not None and presses:
        small = (
            max(4, round(region.height * VIEW_SIZE[1] / size[1])),
            max(4, round(region.width * VIEW_SIZE[0] / size[0])),
        )
        whole = np.asarray(cv2.resize(free, size), np.uint8)
        gel = Reference(_view(region.crop(whole), small), 1, 0)
        structure = ReliefOfReference(gel.view)
        for press in presses:
            added = gel.difference(_view(press, small))
            found = reach(touched_mask(added), structure.of(added, ContactSettings.light_levels))
            expected |= _resize(found.astype(np.uint8), expected.shape) > 0
    return expected if expected.any() else None


def _view(rgb: U8, shape: tuple[int, int]) -> NDArray[np.float32]:
    height, width = shape
    return np.asarray(
        cv2.resize(rgb.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA), np.float32
    )


def _resize(mask: U8, shape: tuple[int, ...]) -> U8:
    return np.asarray(cv2.resize(mask, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST), np.uint8)
