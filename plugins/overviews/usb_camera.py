"""A USB camera as overview camera, through the kernel (V4L2): any camera that sends MJPEG.

Ref: plugins/devices/v4l2, which the sensor uses too. Seen with this program: the choice of the node, on trees laid out
as on Linux 6.1, and the reader on its recorded answers. Not yet seen: a camera on a physical bus.
"""

from pathlib import Path

from pydantic import BaseModel, Field

from edge.core.errors import DeviceNotFound
from edge.core.plugins import DevicePlugin
from edge.core.ports import Clock, Device, DeviceIdentity, DiscoveredDevice
from plugins.devices.v4l2.sensor import V4l2Sensor, VideoNode, open_capture, video_nodes

__all__ = ["UsbCamera", "UsbCameraOptions", "choose", "discovered", "plugin"]

# The touch sensor is a USB camera as well: its product string begins with this.
TOUCH_SENSOR = "GelSight"


class UsbCameraOptions(BaseModel, extra="forbid", frozen=True):
    """Which camera, and the size of its pictures."""

    camera: str | None = Field(
        default=None,
        min_length=1,
        description="its serial, its product string or its node, such as /dev/v4l/by-path/..., if several are there",
    )
    width: int = Field(default=1280, ge=64, le=8192, description="pixels; the camera uses its nearest mode")
    height: int = Field(default=720, ge=64, le=8192, description="pixels; likewise")


def discovered(nodes: list[VideoNode], mode: tuple[int, int]) -> list[DiscoveredDevice]:
    """Every capture node; touch sensors are refused."""
    return [_describe(node, mode) for node in nodes if node.index == 0]


def _describe(node: VideoNode, mode: tuple[int, int]) -> DiscoveredDevice:
    if node.product.startswith(TOUCH_SENSOR):
        return DiscoveredDevice(
            str(node.path), node.product, refusal="it is a touch sensor; use [device] for it"
        )
    return DiscoveredDevice(str(node.path), node.product, _identity(node, mode))


def _identity(node: VideoNode, mode: tuple[int, int]) -> DeviceIdentity:
    """Many cameras have no serial; then the node is the name."""
    return DeviceIdentity(node.product or node.name or "camera", node.serial or str(node.path), mode, 0.0)


def choose(nodes: list[VideoNode], camera: str | None) -> VideoNode:
    """The one camera that fits. Errors: DeviceNotFound for none, or several, with those that are there."""
    able = [node for node in nodes if node.index == 0 and not node.product.startswith(TOUCH_SENSOR)]
    fitting = [
        node for node in able if camera is None or camera in (node.serial, node.product, str(node.path))
    ]
    if len(fitting) == 1:
        return fitting[0]
    seen = ", ".join(f"{node.path} ({node.product} {node.serial})" for node in able) or "none"
    wanted = "one USB camera" if camera is None else f"one USB camera '{camera}'"
    raise DeviceNotFound(
        f"{wanted} is expected, {len(fitting)} fit; seen: {seen}; plug it in, or name its serial, product or node"
    )


class UsbCamera(DevicePlugin[UsbCameraOptions]):
    """The plugin."""

    Options = UsbCameraOptions

    def discover(self, options: UsbCameraOptions) -> list[DiscoveredDevice]:
        return discovered(video_nodes(), (options.width, options.height))

    def open(self, options: UsbCameraOptions, clock: Clock) -> Device:
        """Open the camera. Errors: DeviceNotFound, DeviceBusy."""
        import cv2

        node = choose(video_nodes(), options.camera)
        capture = open_capture(node.path, (options.width, options.height))
        mode = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        place = Path(node.path)
        return V4l2Sensor(
            _identity(node, mode), capture, clock, is_present=place.exists, on_close=lambda: None
        )


plugin = UsbCamera()
