"""Camera controls by name: pinned through UVC requests, in the units and names of V4L2.

Ref: UVC 1.5 tables A-12 and A-13 (selectors), 4-x (sizes); names as v4l2-ctl prints them. Kernels from 5.18 on renamed
some controls; both names are understood here and in the V4L2 path.
"""

import logging
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import usb.core

from plugins.devices.uvc.uvc import CLASS_VIDEO, GET_CUR, REQUEST_GET, REQUEST_SET, SET_CUR, SUBCLASS_CONTROL

__all__ = [
    "NEW_NAMES",
    "UvcControl",
    "pin",
    "pin_uvc_controls",
    "report_unset",
    "uvc_control",
]

_log = logging.getLogger(__name__)

# Old control names (before Linux 5.18) to the present ones.
NEW_NAMES: Mapping[str, str] = {
    "white_balance_temperature_auto": "white_balance_automatic",
    "exposure_auto": "auto_exposure",
    "exposure_absolute": "exposure_time_absolute",
    "exposure_auto_priority": "exposure_dynamic_framerate",
}
# An automatic control must be off before its value can be set.
_AUTOMATICS = ("white_balance_automatic", "auto_exposure", "exposure_dynamic_framerate")
_CAMERA_TERMINAL, _PROCESSING_UNIT = 0x02, 0x05  # descriptor subtypes (table A-5)
# V4L2's menu of auto_exposure (auto, manual, shutter, aperture priority) as UVC's bit (UVC 4.2.2.1.2).
_EXPOSURE_MODE_BITS = (0x02, 0x01, 0x04, 0x08)


@dataclass(frozen=True)
class UvcControl:
    """The address of a control: the descriptor subtype of its entity, its selector, its size in bytes."""

    entity: int
    selector: int
    size: int
    signed: bool = False


_UVC: Mapping[str, UvcControl] = {
    "backlight_compensation": UvcControl(_PROCESSING_UNIT, 0x01, 2),
    "brightness": UvcControl(_PROCESSING_UNIT, 0x02, 2, signed=True),
    "contrast": UvcControl(_PROCESSING_UNIT, 0x03, 2),
    "gain": UvcControl(_PROCESSING_UNIT, 0x04, 2),
    "power_line_frequency": UvcControl(_PROCESSING_UNIT, 0x05, 1),
    "hue": UvcControl(_PROCESSING_UNIT, 0x06, 2, signed=True),
    "saturation": UvcControl(_PROCESSING_UNIT, 0x07, 2),
    "sharpness": UvcControl(_PROCESSING_UNIT, 0x08, 2),
    "gamma": UvcControl(_PROCESSING_UNIT, 0x09, 2),
    "white_balance_temperature": UvcControl(_PROCESSING_UNIT, 0x0A, 2),
    "white_balance_automatic": UvcControl(_PROCESSING_UNIT, 0x0B, 1),
    "auto_exposure": UvcControl(_CAMERA_TERMINAL, 0x02, 1),
    "exposure_dynamic_framerate": UvcControl(_CAMERA_TERMINAL, 0x03, 1),
    "exposure_time_absolute": UvcControl(_CAMERA_TERMINAL, 0x04, 4),
}


def uvc_control(name: str) -> UvcControl | None:
    """The control of that name, old or new, or None when UVC has no such control."""
    return _UVC.get(NEW_NAMES.get(name, name))


def pin(
    controls: Mapping[str, int], set_value: Callable[[str, int], None], get_value: Callable[[str], int]
) -> dict[str, str]:
    """Set every control, read all of them back, and return those with another value, each with the reason.

    `set_value` and `get_value` raise OSError (a USBError is one), or KeyError for a control that is not there;
    `set_value` OverflowError or struct.error for a value that does not fit.
    """
    unset: dict[str, str] = {}
    for name in sorted(controls, key=lambda name: (NEW_NAMES.get(name, name) not in _AUTOMATICS, name)):
        value = controls[name]
        try:
            set_value(name, value)
        except KeyError:
            unset[name] = "this camera has no such control"
        except OSError as error:
            unset[name] = f"setting it to {value} failed: {error.strerror or error}"
        except (OverflowError, struct.error) as error:
            unset[name] = f"setting it to {value} failed: {error}"
    for name, value in controls.items():
        if name not in unset and (actual := _read_back(name, get_value)) != value:
            unset[name] = f"set to {value}, reads back {actual}"
    return unset


def _read_back(name: str, get_value: Callable[[str], int]) -> int | None:
    try:
        return get_value(name)
    except (OSError, KeyError):
        return None


def report_unset(serial: str, unset: Mapping[str, str]) -> None:
    """Log at opening which controls are not pinned: the picture may drift, but inspection is possible."""
    for name, reason in unset.items():
        _log.warning("camera control %s of sensor %s is not pinned: %s", name, serial, reason)


def pin_uvc_controls(device: Any, controls: Mapping[str, int]) -> dict[str, str]:
    """`pin` over the control pipe of a pyusb device whose control interface is claimed."""
    interface, entities = _entities(device)

    def target(name: str) -> tuple[UvcControl, int]:
        control = uvc_control(name)
        if control is None or control.entity not in entities:
            raise KeyError(name)
        return control, entities[control.entity] << 8 | interface

    def set_value(name: str, value: int) -> None:
        control, index = target(name)
        data = _to_uvc(control, value).to_bytes(control.size, "little", signed=control.signed)
        device.ctrl_transfer(REQUEST_SET, SET_CUR, control.selector << 8, index, data)

    def get_value(name: str) -> int:
        control, index = target(name)
        data = device.ctrl_transfer(REQUEST_GET, GET_CUR, control.selector << 8, index, control.size)
        return _from_uvc(control, int.from_bytes(bytes(data), "little", signed=control.signed))

    return pin(controls, set_value, get_value)


def _is_exposure_mode(control: UvcControl) -> bool:
    return (control.entity, control.selector) == (_CAMERA_TERMINAL, 0x02)


def _to_uvc(control: UvcControl, value: int) -> int:
    if not _is_exposure_mode(control):
        return value
    if not 0 <= value < len(_EXPOSURE_MODE_BITS):
        raise usb.core.USBError(f"auto_exposure is 0 to 3, found {value}", None, 34)
    return _EXPOSURE_MODE_BITS[value]


def _from_uvc(control: UvcControl, value: int) -> int:
    if not _is_exposure_mode(control):
        return value
    return _EXPOSURE_MODE_BITS.index(value) if value in _EXPOSURE_MODE_BITS else -1


def _entities(device: Any) -> tuple[int, dict[int, int]]:
    """(control interface number, descriptor subtype to entity id), from the class-specific descriptors."""
    for interface in device.get_active_configuration():
        if (interface.bInterfaceClass, interface.bInterfaceSubClass) == (CLASS_VIDEO, SUBCLASS_CONTROL):
            return int(interface.bInterfaceNumber), _entity_ids(bytes(interface.extra_descriptors))
    return 0, {}


def _entity_ids(extra: Sequence[int]) -> dict[int, int]:
    ids: dict[int, int] = {}
    at = 0
    while at + 4 <= len(extra) and extra[at] >= 4:
        subtype = extra[at + 2]
        if subtype in (_CAMERA_TERMINAL, _PROCESSING_UNIT):
            ids.setdefault(subtype, extra[at + 3])
        at += extra[at]
    return ids
