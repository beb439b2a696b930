"""A sensor streamed by the kernel; OpenCV reads its JPEG bytes without decoding.

Ref: OpenCV modules/videoio/src/cap_v4l.cpp. Seen with a virtual camera on Linux 6.1 and OpenCV 5.0: with the colour
conversion off, `read` gives the JPEG as (1, n) uint8; after an unplug, `read` gives False at once and for ever while
`isOpened` stays true. So the first False ends this stream.

Ref: Documentation/ABI/testing/sysfs-class-video4linux. A UVC camera has two nodes under one name: index 0 captures,
index 1 carries metadata and cannot stream. Node numbers change on every re-plug, the by-id link does not.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.core.errors import DeviceBusy, DeviceLost, DeviceNotFound, DeviceStalled, FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness, damage, kind, picture_size
from edge.core.ports import Clock, DeviceIdentity
from edge.core.sentence import Sentence

__all__ = ["V4l2Sensor", "VideoNode", "capture_node", "open_capture", "video_nodes"]

# OpenCV waits ten seconds for a frame by default; a sensor without a frame for three seconds is opened again.
_SELECT_TIMEOUT = ("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "3")


@dataclass(frozen=True)
class VideoNode:
    """A video node and the USB device behind it. `path` is the by-id link where there is one."""

    path: Path
    name: str
    index: int
    product: str
    serial: str


def video_nodes(sysfs: Path = Path("/sys"), dev: Path = Path("/dev")) -> list[VideoNode]:
    """Every V4L2 node of a USB device, in the order of its number."""
    nodes = sorted(
        (sysfs / "class/video4linux").glob("video*"), key=lambda node: int(node.name.removeprefix("video"))
    )
    return [_node(node, dev) for node in nodes if _usb_device(node) is not None]


def capture_node(serial: str, sysfs: Path = Path("/sys"), dev: Path = Path("/dev")) -> VideoNode:
    """The capture node of the sensor with that serial. Errors: DeviceNotFound with the nodes that exist."""
    nodes = video_nodes(sysfs, dev)
    for node in nodes:
        # Else the end of the product string, without its dash, as on the bus.
        own = node.serial or node.product.rpartition(" ")[2].replace("-", "")
        if own == serial and node.index == 0:
            return node
    seen = ", ".join(f"{node.path} ({node.product} {node.serial}, index {node.index})" for node in nodes)
    raise DeviceNotFound(
        f"the sensor {serial} is on the bus but has no capture node; seen: {seen or 'no video node'}; "
        "check that the kernel module uvcvideo is loaded and that no other program streams over libusb"
    )


def _usb_device(node: Path) -> Path | None:
    """The USB device's folder: the parent of the interface that `device` links to."""
    interface = (node / "device").resolve()
    return interface.parent if (interface.parent / "idVendor").is_file() else None


def _node(node: Path, dev: Path) -> VideoNode:
    usb = _usb_device(node) or node
    path = dev / node.name
    return VideoNode(
        _by_id(path, dev) or path,
        _text(node / "name"),
        int(_text(node / "index") or 0),
        _text(usb / "product"),
        _text(usb / "serial"),
    )


def _by_id(path: Path, dev: Path) -> Path | None:
    links = sorted((dev / "v4l/by-id").glob("*"))
    return next((link for link in links if link.resolve() == path.resolve()), None)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def open_capture(node: Path, mode: tuple[int, int]) -> Any:
    """OpenCV's capture on a node: MJPG of (width, height), undecoded bytes, one buffer.

    Errors: DeviceBusy when it does not open.
    """
    os.environ.setdefault(*_SELECT_TIMEOUT)
    import cv2

    capture = cv2.VideoCapture(str(node), cv2.CAP_V4L2)
    if not capture.isOpened():
        raise DeviceBusy(
            f"{node} cannot be opened; stop any other program that streams, and add the user to the group video"
        )
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, mode[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, mode[1])
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


class V4l2Sensor:
    """An open, streaming sensor (a `Device`).

    capture: `read` gives (ok, uint8 array) and `release` ends it. is_present: asks the bus. on_close: releases the
    lock. A blocked `read` ends with OpenCV's own timeout, not with the deadline: this class cannot wait on the kernel's
    queue. unset_controls: camera controls that could not be pinned, with the reasons.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        capture: Any,
        clock: Clock,
        *,
        is_present: Callable[[], bool],
        on_close: Callable[[], None],
    ) -> None:
        self.identity = identity
        self.unset_controls: dict[str, str] = {}
        self._capture, self._clock = capture, clock
        self._is_present, self._on_close = is_present, on_close
        self._freshness = Freshness()
        self._sequence = 0
        self._lost: str | None = None
        self._is_closed = False

    @property
    def stale(self) -> int:
        return self._freshness.stale

    def read(self, deadline_ns: int) -> CameraFrame:
        while True:
            payload = self._next_payload()
            if self._freshness.is_new(payload):
                frame = CameraFrame(payload, self._clock.monotonic_ns(), self._sequence)
                self._sequence += 1
                return frame
            if self._clock.monotonic_ns() >= deadline_ns:
                raise DeviceStalled(
                    Sentence(f"{self.identity.product} repeats the same frame ({self.stale} times)")
                )

    def _next_payload(self) -> bytes:
        if self._lost is not None:
            raise DeviceLost(self._lost)
        came, data = self._capture.read()
        if not came:
            product = self.identity.product
            if self._is_present():
                self._lost = Sentence(f"{product} stopped sending; it is opened again")
            else:
                self._lost = Sentence(f"{product} was unplugged; it is opened again")
            raise DeviceLost(self._lost)
        payload = bytes(data)
        fault = self._fault(payload)
        if fault is not None:
            self._sequence += 1
            raise FrameCorrupt(f"{self.identity.product}, frame {self._sequence - 1}: {fault}")
        return payload

    def _fault(self, payload: bytes) -> str | None:
        if kind(payload) != "jpg":
            return f"{len(payload)} bytes that are not a JPEG; OpenCV may have converted them"
        size = picture_size(payload)
        if size != self.identity.mode:
            return f"a picture of {size}; the video mode is {self.identity.mode}"
        return damage(payload)

    def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            self._lost = self._lost or f"{self.identity.product} was closed"
            self._capture.release()
            self._on_close()
