"""Buttons and relays at the GPIO lines of a Linux board, through libgpiod.

# Ref: gpiod 2.5.0 (the bindings of libgpiod by its own maintainers); Linux GPIO character device, uAPI version 2. With
# active_low the kernel inverts levels and edges. Not run on a board by us: the tests replace the kernel's part.
"""

import errno
import os
from collections import deque
from collections.abc import Callable, Mapping
from datetime import timedelta
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, field_validator

from edge.core.digital_io import DiscoveredPort
from edge.core.errors import ConfigError, DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, DeviceStalled
from edge.core.ports import Clock
from plugins.digital_io import PortPlugin

__all__ = ["ButtonOptions", "GpioButton", "GpioRelays", "Kernel", "RelaysOptions", "actuator", "trigger"]

T = TypeVar("T")

CHIP = Field(default="/dev/gpiochip0", pattern="^/dev/", description="the GPIO chip; `gpiodetect` lists them")


class ButtonOptions(BaseModel, extra="forbid", frozen=True):
    """Which line, and how the button is wired."""

    chip: str = CHIP
    line: int = Field(ge=0, description="the line's number on its chip; `gpioinfo` lists them")
    active_low: bool = Field(default=True, description="pressed is 0 V, as with a button to ground")
    bias: Literal["pull_up", "pull_down", "disabled"] = Field(
        default="pull_up", description="the chip's own resistor"
    )


class RelaysOptions(BaseModel, extra="forbid", frozen=True):
    """Which lines are channel 1, channel 2 and so on."""

    chip: str = CHIP
    lines: tuple[int, ...] = Field(
        min_length=1, max_length=64, description="one for each channel, in their order"
    )
    active_low: bool = Field(default=False, description="on is 0 V, as with most relay modules")

    @field_validator("lines")
    @classmethod
    def _one_channel_each(cls, lines: tuple[int, ...]) -> tuple[int, ...]:
        """Refuse a line of two channels: what switches one on would light the other."""
        twice = next((line for line in lines if lines.count(line) > 1), None)
        if twice is not None:
            raise ValueError(f"line {twice} is that of several channels; give each channel a line of its own")
        return lines


class Kernel:
    """What is asked of the kernel; tests replace it. Errors: OSError."""

    def request(self, chip: str, settings: Mapping[int, Any]) -> Any:
        """The lines, requested for this process alone: a `gpiod.LineRequest`."""
        return _gpiod().request_lines(chip, dict(settings), "gelgate")

    def is_output(self, chip: str, line: int) -> bool:
        """Tell whether the line drives its level now."""
        gpiod = _gpiod()
        with gpiod.Chip(chip) as opened:
            return bool(opened.get_line_info(line).direction == gpiod.line.Direction.OUTPUT)

    def has_chip(self, chip: str) -> bool:
        return os.path.exists(chip)


class _Lines:
    """Open lines of a chip."""

    def __init__(self, kernel: Kernel, chip: str, name: str, request: Callable[[], Any]) -> None:
        self.name = name
        self._kernel, self._chip = kernel, chip
        self._request: Any = _call(name, request)

    @property
    def lines(self) -> Any:
        """The requested lines. Errors: DeviceLost once they are closed."""
        if self._request is None:
            raise DeviceLost(f"{self.name} was closed")
        return self._request

    def is_present(self) -> bool:
        return self._request is not None and self._kernel.has_chip(self._chip)

    def close(self) -> None:
        request, self._request = self._request, None
        if request is not None:
            request.release()


class GpioButton(_Lines):
    """An open line with a button."""

    def __init__(self, kernel: Kernel, options: ButtonOptions, clock: Clock) -> None:
        gpiod = _gpiod()
        settings = gpiod.LineSettings(
            direction=gpiod.line.Direction.INPUT,
            edge_detection=gpiod.line.Edge.BOTH,
            bias=gpiod.line.Bias[options.bias.upper()],
            active_low=options.active_low,
        )
        name = f"line {options.line} of {options.chip}"
        super().__init__(
            kernel, options.chip, name, lambda: kernel.request(options.chip, {options.line: settings})
        )
        self._clock, self._rising = clock, gpiod.EdgeEvent.Type.RISING_EDGE
        self._changes: deque[bool] = deque()
        self._is_down = False

    def read(self, deadline_ns: int) -> bool | None:
        request = self.lines
        if not self._changes:
            wait_s = max(0, deadline_ns - self._clock.monotonic_ns()) / 1e9
            if _call(self.name, lambda: request.wait_edge_events(timedelta(seconds=wait_s))):
                events = _call(self.name, request.read_edge_events)
                self._changes.extend(event.event_type == self._rising for event in events)
        while self._changes:
            is_down = self._changes.popleft()
            if is_down != self._is_down:
                self._is_down = is_down
                return is_down
        return None


class GpioRelays(_Lines):
    """Open lines with relays. Each write is read back."""

    def __init__(self, kernel: Kernel, options: RelaysOptions) -> None:
        self.channels, self._options = len(options.lines), options
        name = f"lines {', '.join(map(str, options.lines))} of {options.chip}"
        super().__init__(kernel, options.chip, name, lambda: _request_outputs(kernel, options))

    def write(self, channel: int, is_on: bool) -> None:
        if not 1 <= channel <= self.channels:
            raise ValueError(f"{self.name} are channels 1 to {self.channels}, found {channel}")
        request, line = self.lines, self._options.lines[channel - 1]
        value = _gpiod().line.Value(int(is_on))
        _call(self.name, lambda: request.set_value(line, value))
        if _call(self.name, lambda: request.get_value(line)) != value:
            raise DeviceStalled(
                f"line {line} of {self._options.chip} does not take its level; is it short-circuited?"
            )


def _request_outputs(kernel: Kernel, options: RelaysOptions) -> Any:
    """Request the lines: outputs keep their level, others start from off."""
    gpiod, active_low = _gpiod(), options.active_low
    as_is = gpiod.LineSettings(direction=gpiod.line.Direction.AS_IS, active_low=active_low)
    driven = [kernel.is_output(options.chip, line) for line in options.lines]
    request = kernel.request(options.chip, dict.fromkeys(options.lines, as_is))
    levels = [
        request.get_value(line) if is_driven else gpiod.line.Value.INACTIVE
        for line, is_driven in zip(options.lines, driven, strict=True)
    ]
    request.reconfigure_lines(
        {
            line: gpiod.LineSettings(
                direction=gpiod.line.Direction.OUTPUT, active_low=active_low, output_value=level
            )
            for line, level in zip(options.lines, levels, strict=True)
        }
    )
    return request


def _call(name: str, call: Callable[[], T]) -> T:
    try:
        return call()
    except OSError as error:
        raise _device_error(name, error) from error


def _device_error(name: str, error: OSError) -> DeviceError:
    if isinstance(error, FileNotFoundError):
        return DeviceNotFound(f"{name}: there is no such chip; `gpiodetect` lists them")
    if isinstance(error, PermissionError):
        return DeviceBusy(
            f"{name}: this user may not open the chip; give the group gelgate rights by a udev rule"
        )
    if error.errno == errno.EBUSY:
        return DeviceBusy(f"{name}: another program or driver uses it; `gpioinfo` names it")
    return DeviceLost(f"{name} cannot be used: {error.strerror or error}")


def _gpiod() -> Any:
    """Import gpiod. Errors: ConfigError where it is not installed."""
    try:
        import gpiod
    except ImportError as error:
        raise ConfigError("GPIO lines need gpiod, not installed here; pip install 'gelgate[gpio]'") from error
    return gpiod


def _discovered(kernel: Kernel, chip: str, product: str) -> list[DiscoveredPort]:
    _gpiod()
    return [DiscoveredPort(chip, product)] if kernel.has_chip(chip) else []


trigger = PortPlugin(
    ButtonOptions,
    discover=lambda options: _discovered(Kernel(), options.chip, f"button at line {options.line}"),
    open=lambda options, clock: GpioButton(Kernel(), options, clock),
)
actuator = PortPlugin(
    RelaysOptions,
    discover=lambda options: _discovered(Kernel(), options.chip, f"{len(options.lines)} relays"),
    open=lambda options, clock: GpioRelays(Kernel(), options),
)
