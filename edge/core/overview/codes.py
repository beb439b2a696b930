"""The codes on a part: QR and AprilTag, read by OpenCV, and DataMatrix, read by zxing-cpp (the extra `datamatrix`)."""

from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.overview.view import Code, CodeKind, TagFamily
from edge.core.printable import printable

__all__ = ["read_codes"]

# Longer than any id on a part: a QR code has room for 4,296 letters, a DataMatrix for 2,335. This text is published.
MOST_LETTERS: Final = 256


def read_codes(
    grey: NDArray[np.uint8], kinds: Sequence[CodeKind], family: TagFamily = "36h11"
) -> tuple[Code, ...]:
    """Every code of these kinds, sorted, each once. grey: uint8 (h, w). Not for two threads at once."""
    codes = {
        *(_qr_codes(grey) if "qr" in kinds else ()),
        *(_april_tags(grey, family) if "apriltag" in kinds else ()),
        *(_data_matrices(grey) if "datamatrix" in kinds else ()),
    }
    return tuple(sorted(codes, key=lambda code: (code.kind, code.text)))


def _qr_codes(grey: NDArray[np.uint8]) -> list[Code]:
    # OpenCV hands a code in Kanji mode to Python as UTF-8, which it is not: the id cannot be read, and others neither.
    try:
        _, texts, _, _ = _qr_reader().detectAndDecodeMulti(grey)
    except UnicodeDecodeError:
        return []
    return [Code("qr", printable(text)[:MOST_LETTERS]) for text in texts if text]


def _april_tags(grey: NDArray[np.uint8], family: TagFamily) -> list[Code]:
    _, numbers, _ = _tag_reader(family).detectMarkers(grey)
    return [] if numbers is None else [Code("apriltag", str(int(number))) for number in numbers.ravel()]


def _data_matrices(grey: NDArray[np.uint8]) -> list[Code]:
    """The text as it is in the code, without brackets around the fields of GS1."""
    import zxingcpp

    barcodes = zxingcpp.read_barcodes(
        grey, formats=zxingcpp.BarcodeFormat.DataMatrix, text_mode=zxingcpp.TextMode.Plain
    )
    return [Code("datamatrix", printable(one.text)[:MOST_LETTERS]) for one in barcodes if one.text]


@cache
def _qr_reader() -> Any:
    return cv2.QRCodeDetector()


@cache
def _tag_reader(family: TagFamily) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    # Corners are not needed to a fraction of a pixel, only the number.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(_FAMILIES[family]), parameters)


_FAMILIES: Final[dict[TagFamily, int]] = {
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
}
