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


def encoded(grey: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", grey)[1].tobytes()


def _with(code: NDArray[np.uint8]) -> NDArray[np.uint8]:
    still = blank()
    side = len(code)
    top, left = (SIZE[1] - side) // 2, (SIZE[0] - side) // 2
    still[top - 20 : top + side + 20, left - 20 : left + side + 20] = 255
    still[top : top + side, left : left + side] = code
    return still
