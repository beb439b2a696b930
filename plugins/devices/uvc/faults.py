"""USB errors as gelgate's errors: one table, applied where pyusb is called."""

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from edge.core.errors import DeviceBusy, DeviceError, DeviceLost, DeviceStalled
from edge.core.sentence import Sentence

__all__ = ["BY_ERRNO", "guarded"]

# errno of a usb.core.USBError (pyusb 1.3.1, usb/backend/libusb1.py, its return and transfer code tables) to our error
# and what to do. Anything else means that the sensor stopped answering.
BY_ERRNO: Mapping[int, tuple[type[DeviceError], str]] = {
    errno.EBUSY: (
        DeviceBusy,
        Sentence("another process or the kernel's uvcvideo driver holds it; stop that first"),
    ),
    errno.EACCES: (
        DeviceBusy,
        Sentence("no permission; run `gelgate station install-service` as root and plug the sensor in again"),
    ),
    errno.ENOSPC: (
        DeviceBusy,
        Sentence("no bandwidth is left on this USB bus; plug every sensor into a separate root port"),
    ),
    errno.ENODEV: (DeviceLost, Sentence("it was unplugged")),
    errno.ETIMEDOUT: (DeviceStalled, Sentence("it did not answer in time")),
}
_OTHERWISE = (DeviceLost, Sentence("it stopped answering; it is opened again"))


@contextmanager
def guarded(who: str) -> Iterator[None]:
    """Turns what pyusb or the system raises inside into a DeviceError that names the sensor."""
    try:
        yield
    except OSError as error:  # a USBError is one
        kind, advice = BY_ERRNO.get(error.errno or 0, _OTHERWISE)
        raise kind(Sentence(f"{who}: {error.strerror or error} (errno {error.errno}): {advice}")) from error
    except NotImplementedError as error:
        raise DeviceLost(f"{who}: this USB library cannot do that here: {error}") from error
    except ValueError as error:  # an answer that is too short, or makes no sense
        raise DeviceLost(f"{who}: {error}; it is opened again") from error
