"""Camera controls through V4L2 ioctls, by the names that v4l2-ctl prints, old and new.

Ref: include/uapi/linux/videodev2.h. With uvcvideo bound, a class request through libusb fails as busy. So while the
kernel streams, controls are only reachable here.
"""

import fcntl
import os
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from plugins.devices.uvc.controls import NEW_NAMES, pin

__all__ = ["control_ids", "control_name", "pin_v4l2_controls"]

# struct v4l2_queryctrl: id, type, name, minimum, maximum, step, default, flags, reserved.
_QUERY = struct.Struct("=II32siiiiI8x")
_CONTROL = struct.Struct("=Ii")  # struct v4l2_control: id, value
_VIDIOC_QUERYCTRL, _VIDIOC_G_CTRL, _VIDIOC_S_CTRL = 0xC0445624, 0xC008561B, 0xC008561C
_NEXT, _DISABLED = 0x80000000, 0x0001

Ioctl = Callable[[int, int, bytes], bytes]


def control_name(title: str) -> str:
    """`Exposure Time, Absolute` is exposure_time_absolute."""
    return re.sub(r"[^a-z0-9]+", "_", title.lower()).strip("_")


def control_ids(fd: int, ioctl: Ioctl = fcntl.ioctl) -> dict[str, int]:
    """Every control that the camera has, by its present name."""
    return {NEW_NAMES.get(name, name): number for name, number in _enumerated(fd, ioctl)}


def _enumerated(fd: int, ioctl: Ioctl) -> Iterator[tuple[str, int]]:
    number = 0
    while True:
        try:
            answer = ioctl(fd, _VIDIOC_QUERYCTRL, _QUERY.pack(number | _NEXT, 0, b"", 0, 0, 0, 0, 0))
        except OSError:
            return  # EINVAL: there is no next one
        number, _, title, *_, flags = _QUERY.unpack(answer)
        if not flags & _DISABLED:
            yield control_name(title.split(b"\0")[0].decode("ascii", "replace")), number


def pin_v4l2_controls(node: Path, controls: Mapping[str, int], ioctl: Ioctl = fcntl.ioctl) -> dict[str, str]:
    """Set and read back; returns the controls with another value, each with the reason. Errors: OSError without a
    node."""
    if not controls:
        return {}
    fd = os.open(node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        ids = control_ids(fd, ioctl)

        def set_value(name: str, value: int) -> None:
            ioctl(fd, _VIDIOC_S_CTRL, _CONTROL.pack(ids[NEW_NAMES.get(name, name)], value))

        def get_value(name: str) -> int:
            answer = ioctl(fd, _VIDIOC_G_CTRL, _CONTROL.pack(ids[NEW_NAMES.get(name, name)], 0))
            return int(_CONTROL.unpack(answer)[1])

        return pin(controls, set_value, get_value)
    finally:
        os.close(fd)
