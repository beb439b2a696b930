"""USB errors become device errors by one table."""

import errno

import pytest
import usb.backend.libusb1 as libusb1
import usb.core

from edge.core.errors import DeviceBusy, DeviceError, DeviceLost, DeviceStalled
from plugins.devices.uvc.faults import guarded


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.EBUSY, DeviceBusy),
        (errno.EACCES, DeviceBusy),
        (errno.ENOSPC, DeviceBusy),
        (errno.ENODEV, DeviceLost),
        (errno.EPIPE, DeviceLost),
        (errno.ETIMEDOUT, DeviceStalled),
        (None, DeviceLost),
    ],
)
def test_by_errno(number: int | None, kind: type[DeviceError]) -> None:
    """Busy, no permission and no bandwidth are Busy; unplugged or failed is Lost; late is Stalled. The sensor is
    named."""
    with pytest.raises(kind, match="the sensor"), guarded("the sensor"):
        raise usb.core.USBError("text", -1, number)


@pytest.mark.parametrize("code", sorted(libusb1._libusb_errno))
def test_every_code_of_libusb_is_a_device_error(code: int) -> None:
    """Every code that pyusb's backend can raise becomes a DeviceError."""
    with pytest.raises(DeviceError), guarded("the sensor"):
        raise usb.core.USBError("text", code, libusb1._libusb_errno[code])
