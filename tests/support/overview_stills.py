"""Stills of an overview camera: a grey table with a part on it that carries a code."""

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = (320, 240)


def blank() -> NDArray[np.uint8]:
    """The empty table, uint8 (h, w)."""
    return np.full(SIZE[::-1], 150, np.uint8)


def with_tag(number: int, family: int = cv2.aruco.DICT_APRILTAG_36h11) -> NDArray[np.uint8]:
    """A white part with an AprilTag."""
    dictionary = cv2.aruco.getPredefinedDictionary(family)
    return _with(cv2.aruco.generateImageMarker(dictionary, number, 100))


def with_qr(text: str, mode: int = cv2.QRCODE_ENCODER_MODE_AUTO) -> NDArray[np.uint8]:
    """A white part with a QR code."""
    parameters = cv2.QRCodeEncoder.Params()
    parameters.mode = mode
    code = cv2.QRCodeEncoder.create(parameters).encode(text)
    return _with(cv2.resize(code, (150, 150), interpolation=cv2.INTER_NEAREST))


def with_data_matrix(text: str, *, gs1: bool = False) -> NDArray[np.uint8]:
    """A white part with a DataMatrix code; for GS1 each field begins with its number in brackets."""
    import zxingcpp

    code = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.DataMatrix, gs1=gs1)
    return _with(np.array(code.to_image(scale=6), np.uint8))


def encoded(grey: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", grey)[1].tobytes()


def _with(code: NDArray[np.uint8]) -> NDArray[np.uint8]:
    still = blank()
    h, w = code.shape
    top, left = (SIZE[1] - h) // 2, (SIZE[0] - w) // 2
    still[top - 20 : top + h + 20, left - 20 : left + w + 20] = 255
    still[top : top + h, left : left + w] = code
    return still
