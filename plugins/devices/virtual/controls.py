"""The camera controls of a virtual camera: ranges and defaults as measured publicly on a sibling board (B0268)."""

from collections.abc import Mapping
from typing import Any

from plugins.devices.uvc.controls import UvcControl, uvc_control
from plugins.devices.uvc.uvc import GET_CUR, GET_DEF, GET_INFO, GET_LEN, GET_MAX, GET_MIN, GET_RES, SET_CUR
from plugins.devices.virtual.descriptors import CAMERA_TERMINAL, PROCESSING_UNIT

__all__ = ["RANGES", "ControlBank"]

# name: minimum, maximum, default; automatic controls are on, as on every new camera.
RANGES: Mapping[str, tuple[int, int, int]] = {
    "brightness": (-64, 64, 0),
    "contrast": (0, 64, 32),
    "saturation": (0, 128, 64),
    "hue": (-40, 40, 0),
    "gamma": (72, 500, 100),
    "gain": (0, 100, 0),
    "sharpness": (0, 6, 3),
    "backlight_compensation": (0, 2, 1),
    "power_line_frequency": (0, 2, 1),
    "white_balance_automatic": (0, 1, 1),
    "white_balance_temperature": (2800, 6500, 4600),
    "auto_exposure": (1, 8, 8),  # UVC's bits: 1 manual, 8 aperture priority
    "exposure_dynamic_framerate": (0, 1, 1),
    "exposure_time_absolute": (1, 5000, 157),
}
_GET_AND_SET = b"\x03"  # table 4-3: the control answers GET and takes SET
_EXPOSURE_MODES = 0x01 | 0x08  # for modes the resolution is the set of them: manual and aperture priority
_ENTITY = {0x02: CAMERA_TERMINAL, 0x05: PROCESSING_UNIT}


class ControlBank:
    """Values by (entity id, selector). A value out of range, or under an automatic control that is on, is a stall."""

    def __init__(self) -> None:
        self._names: dict[tuple[int, int], tuple[str, UvcControl]] = {}
        for name in RANGES:
            control = uvc_control(name)
            if control is not None:
                self._names[_ENTITY[control.entity], control.selector] = name, control
        self.values = {name: default for name, (_, _, default) in RANGES.items()}

    def request(self, request: int, entity: int, selector: int, data: Any) -> bytes | None:
        """The answer to a GET, empty for an accepted SET, None for a stall."""
        if (entity, selector) not in self._names:
            return None
        name, control = self._names[entity, selector]
        low, high, default = RANGES[name]
        if request == SET_CUR:
            return self._set(name, int.from_bytes(bytes(data), "little", signed=control.signed))
        if request == GET_INFO:
            return _GET_AND_SET
        if request == GET_LEN:
            return control.size.to_bytes(2, "little")
        step = _EXPOSURE_MODES if name == "auto_exposure" else 1
        answers = {GET_CUR: self.values[name], GET_MIN: low, GET_MAX: high, GET_RES: step, GET_DEF: default}
        value = answers.get(request)
        return None if value is None else value.to_bytes(control.size, "little", signed=control.signed)

    def _set(self, name: str, value: int) -> bytes | None:
        low, high, _ = RANGES[name]
        ruled = (name == "white_balance_temperature" and self.values["white_balance_automatic"]) or (
            name == "exposure_time_absolute" and self.values["auto_exposure"] == 8
        )
        if ruled or not low <= value <= high:
            return None
        self.values[name] = value
        return b""
