"""HID devices through hidapi, behind a boundary that `virtual_hid` replaces.

# Ref: hidapi 0.15.0 (github.com/trezor/cython-hidapi). Seen on Linux 6.1: a read of a vanished device returns nothing
# and raises nothing, so presence is asked of `enumerate`. The module `hidraw` sees devices that `hid` (libusb) does
# not.
# Known: it is not safe for threads (libusb/hidapi issues 45, 133, 649; cython-hidapi 148): here every search, opening
# and closing has one lock, and one thread uses an open device.
"""

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Protocol

from edge.core.errors import ConfigError, DeviceBusy, DeviceLost

__all__ = ["HidBus", "HidHandle", "HidInfo", "HidPort", "SystemHidBus"]

_LOCK: Final = threading.Lock()


@dataclass(frozen=True)
class HidInfo:
    """One HID interface."""

    path: bytes
    vendor_id: int
    product_id: int
    product: str
    serial: str = ""
    usage: tuple[int, int] = (0, 0)
    """(page, usage), (0, 0) where the system does not know it."""

    @property
    def place(self) -> str:
        """Such as `/dev/hidraw3`."""
        return self.path.decode(errors="replace")

    @property
    def ids(self) -> str:
        """Such as `16c0:05df`."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}"


class HidHandle(Protocol):
    """An open interface. Errors of every call: DeviceLost."""

    def read(self, most: int, timeout_s: float) -> bytes:
        """Read an input report, empty when none came in time."""

    def send_feature(self, report: bytes) -> None:
        """The first byte is the report id, 0 where the device has none."""

    def get_feature(self, report_id: int, most: int) -> bytes:
        """The report, with its id first."""

    def close(self) -> None: ...


class HidBus(Protocol):
    """What is plugged in."""

    def enumerate(self) -> Sequence[HidInfo]:
        """Every HID interface, in a fixed order."""

    def open(self, info: HidInfo) -> HidHandle:
        """Open an interface. Errors: DeviceBusy without the rights to it, DeviceLost."""


class HidPort:
    """An open interface, as a pedal or a board has it."""

    def __init__(self, bus: HidBus, info: HidInfo) -> None:
        self.name = f"{info.product} at {info.place}"
        self._bus, self._info = bus, info
        self._handle: HidHandle | None = bus.open(info)

    def is_present(self) -> bool:
        """Tell whether the same interface is still there."""
        return self._handle is not None and self._info in self._bus.enumerate()

    def close(self) -> None:
        """Close it; harmless when repeated."""
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.close()

    @property
    def handle(self) -> HidHandle:
        """The open interface. Errors: DeviceLost once it is closed."""
        if self._handle is None:
            raise DeviceLost(f"{self.name} was closed")
        return self._handle


class SystemHidBus:
    """The HID devices of this machine."""

    def enumerate(self) -> list[HidInfo]:
        """List the interfaces on the bus. Errors: ConfigError without hidapi."""
        module = _module()
        with _LOCK:
            interfaces = module.enumerate()
        return sorted(map(_info, interfaces), key=lambda info: info.path)

    def open(self, info: HidInfo) -> HidHandle:
        device = _module().device()
        try:
            with _LOCK:
                device.open_path(info.path)
        except OSError as error:
            if os.path.exists(info.path) and not os.access(info.path, os.R_OK | os.W_OK):
                raise DeviceBusy(
                    f"this user may not open {info.product} at {info.place}; `gelgate station install-service` "
                    "installs the udev rule, then plug it in again"
                ) from error
            raise DeviceLost(f"{info.product} at {info.place} cannot be opened: {error}") from error
        return _SystemHandle(device, info)


class _SystemHandle:
    def __init__(self, device: Any, info: HidInfo) -> None:
        self._device, self._info = device, info

    def read(self, most: int, timeout_s: float) -> bytes:
        # 0 would wait without end in some versions.
        return bytes(self._call("read", most, max(1, round(timeout_s * 1000))))

    def send_feature(self, report: bytes) -> None:
        if self._call("send_feature_report", report) < 0:
            raise DeviceLost(
                f"{self._info.product} at {self._info.place} takes no report: {self._device.error()}"
            )

    def get_feature(self, report_id: int, most: int) -> bytes:
        return bytes(self._call("get_feature_report", report_id, most))

    def close(self) -> None:
        with _LOCK:
            self._device.close()

    def _call(self, name: str, *given: object) -> Any:
        try:
            return getattr(self._device, name)(*given)
        except (OSError, ValueError) as error:  # ValueError: not open
            raise DeviceLost(f"{self._info.product} at {self._info.place} is gone: {error}") from error


def _module() -> Any:
    """Import hidapi. Errors: ConfigError where it is not installed."""
    for name in ("hidraw", "hid"):
        try:
            return import_module(name)
        except ImportError:
            continue
    raise ConfigError("HID devices need hidapi, not installed here; pip install 'gelgate[hid]'")


def _info(one: dict[str, Any]) -> HidInfo:
    return HidInfo(
        one["path"],
        one["vendor_id"],
        one["product_id"],
        one.get("product_string") or "HID device",
        one.get("serial_number") or "",
        (one.get("usage_page") or 0, one.get("usage") or 0),
    )
