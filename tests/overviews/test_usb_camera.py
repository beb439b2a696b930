"""Which USB camera is the overview camera."""

from pathlib import Path

import pytest

from edge.core.errors import DeviceNotFound
from plugins.devices.v4l2.sensor import VideoNode
from plugins.overviews.usb_camera import choose, discovered

WEBCAM = VideoNode(Path("/dev/video0"), "HD Webcam: HD Webcam", 0, "HD Webcam", "SN0001")
METADATA = VideoNode(Path("/dev/video1"), "HD Webcam: HD Webcam", 1, "HD Webcam", "SN0001")
SENSOR = VideoNode(Path("/dev/video2"), "GelSight Mini R0B", 0, "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7")
NAMELESS = VideoNode(Path("/dev/video4"), "USB Camera", 0, "", "")


def test_the_only_camera_is_chosen() -> None:
    """The touch sensor and the metadata node are no overview cameras."""
    assert choose([METADATA, SENSOR, WEBCAM], None) is WEBCAM


@pytest.mark.parametrize("name", ["SN0001", "HD Webcam", "/dev/video0"])
def test_a_camera_is_named_by_serial_product_or_node(name: str) -> None:
    """Where several are plugged in."""
    assert choose([NAMELESS, WEBCAM, SENSOR], name) is WEBCAM


@pytest.mark.parametrize("name", [None, "SN0002", "2BNN4ZE7"])
def test_none_or_several_are_refused(name: str | None) -> None:
    """With those that are there; the touch sensor cannot be named either."""
    with pytest.raises(DeviceNotFound, match=r"/dev/video4 \(.*/dev/video0 \(HD Webcam SN0001\)"):
        choose([NAMELESS, WEBCAM, SENSOR], name)


def test_the_search_says_why_a_touch_sensor_is_none() -> None:
    """And a camera without a serial is named by its node."""
    sensor, nameless = discovered([SENSOR, METADATA, NAMELESS], (1280, 720))

    assert sensor.refusal == "it is a touch sensor; use [device] for it"
    assert nameless.identity is not None
    assert (nameless.identity.product, nameless.identity.serial) == ("USB Camera", "/dev/video4")
