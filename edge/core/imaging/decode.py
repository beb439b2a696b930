"""From camera bytes to a picture, and to the small view that the contact detector looks at.

This is the only place where colour order changes (BGR of the decoder to RGB) and where pixels are scaled.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import kind
from edge.core.imaging.known_profiles import PROFILES
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["VIEW_SIZE", "decode", "decode_view"]

# (width, height) of the contact view. A part touches thousands of the 76,800 pixels of a 320x240 picture, so a quarter
# of them is enough. The work outside the JPEG decoder takes less than a millisecond.
VIEW_SIZE = (160, 120)

_FLAGS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def decode(frame: CameraFrame, profile: SensorProfile) -> NDArray[np.uint8]:
    """The picture of a frame in its profile's geometry: RGB uint8, (h, w, 3) of profile.size.

    The payload is a JPEG or a PNG; the JPEG is decoded at 1/decode_scale in the DCT domain. Errors: FrameCorrupt for
    bytes that are not a picture, end early, or have another native size.
    """
    return _to_rgb(_resize(_crop(frame, profile, profile.decode_scale), profile.size))


def decode_view(frame: CameraFrame, profile: SensorProfile) -> NDArray[np.float32]:
    """A small view for the contact detector: float32 (120, 160, 3), RGB, 0 to 255, of the same crop.

    Decoded at the coarsest JPEG scale that still has a pixel for each of the view's. At 1/8 of 3280x2464 the crop's
    edge may be half a reduced pixel (4 camera pixels) off the picture's. Errors as `decode`.
    """
    bgr = _resize(_crop(frame, profile, _view_scale(profile)), VIEW_SIZE)
    return _to_rgb(bgr).astype(np.float32)


def _crop(frame: CameraFrame, profile: SensorProfile, scale: int) -> NDArray[np.uint8]:
    if frame.damage is not None:
        raise FrameCorrupt(f"frame {frame.sequence} is {frame.damage}; look for lost USB packets")
    if frame.size != profile.native:
        fitting = ", ".join(one.name for one in PROFILES.values() if one.native == frame.size)
        raise FrameCorrupt(
            f"frame {frame.sequence} is {_size_text(frame.size)}, profile '{profile.name}' expects "
            f"{_size_text(profile.native)}; choose the profile of its camera with --profile: "
            f"{fitting or 'none that ships is of this size'}"
        )
    left, top, right, bottom = _crop_box(profile, scale)
    return _reduce(frame, scale)[top:bottom, left:right]


def _crop_box(profile: SensorProfile, scale: int) -> tuple[int, int, int, int]:
    """left, top, right, bottom in pixels of the reduced frame: cut in camera pixels, then scaled and rounded."""
    (width, height), (x, y) = profile.native, profile.border
    left, top = int(width * x), int(height * y)
    box = (left, top, width - left, height - top)
    return (
        round(box[0] / scale),
        round(box[1] / scale),
        min(round(box[2] / scale), -(-width // scale)),
        min(round(box[3] / scale), -(-height // scale)),
    )


def _reduce(frame: CameraFrame, scale: int) -> NDArray[np.uint8]:
    """Decode BGR uint8 at 1/scale, rounded up as libjpeg does."""
    if kind(frame.payload) != "jpg":
        bgr = _imdecode(frame, cv2.IMREAD_COLOR)
        height, width = bgr.shape[:2]
        return _resize(bgr, (-(-width // scale), -(-height // scale)))
    bgr = _imdecode(frame, _FLAGS[scale])
    # Where the decoder ran out of data the last rows are one flat colour, unlike the others. `quality` judges a picture
    # that is flat everywhere (black, saturated). A gap within the bytes shows only here, from 3 to 6 kB on in frames of
    # 3280x2464. So no frame is decoded in part, although a smaller height in its header would give the rows above the
    # lower border bit by bit in 10 to 15 % less time.
    tail, head = bgr[-2:], bgr[: max(1, bgr.shape[0] // 8)]
    if (tail == tail[0, 0]).all() and (head != tail[0, 0]).any():
        raise FrameCorrupt(
            f"frame {frame.sequence} has no picture data in its last rows; look for lost USB packets"
        )
    return bgr


def _imdecode(frame: CameraFrame, flag: int) -> NDArray[np.uint8]:
    try:
        pixels = cv2.imdecode(np.frombuffer(frame.payload, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise FrameCorrupt(f"frame {frame.sequence} cannot be decoded: {error.err}") from error
    if pixels is None:
        raise FrameCorrupt(
            f"frame {frame.sequence} cannot be decoded: {len(frame.payload)} bytes are not a picture"
        )
    return np.asarray(pixels, dtype=np.uint8)


def _resize(bgr: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    if (bgr.shape[1], bgr.shape[0]) == size:
        return bgr
    return np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _to_rgb(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _view_scale(profile: SensorProfile) -> int:
    """The coarsest JPEG reduction whose crop is still at least as large as the view."""
    width = profile.native[0] * (1 - 2 * profile.border[0])
    height = profile.native[1] * (1 - 2 * profile.border[1])
    fits = (s for s in (8, 4, 2) if width / s >= VIEW_SIZE[0] and height / s >= VIEW_SIZE[1])
    return next(fits, 1)


def _size_text(size: tuple[int, int] | None) -> str:
    return "of unreadable size" if size is None else f"{size[0]}x{size[1]}"
