"""Which /dev/video node streams from a given sensor.

Ref: Documentation/ABI/testing/sysfs-class-video4linux. A UVC camera has two nodes under one name: index 0 captures,
index 1 carries metadata and cannot stream. Node numbers change on every re-plug, the by-id link does not.
"""

from dataclasses import dataclass
from pathlib import Path

from edge.core.errors import DeviceNotFound

__all__ = ["VideoNode", "capture_node", "video_nodes"]


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
        if node.serial == serial and node.index == 0:
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
