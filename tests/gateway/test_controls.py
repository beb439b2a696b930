"""The bundle's sensor profile pins the camera's controls."""

from pathlib import Path
from typing import Any

import pytest
from small_recordings import write_recording

from edge.clock import ManualClock
from edge.config import PluginTable
from edge.gateway.opening import device_opener
from plugins.devices import usb_mock


def test_profile_controls_reach_the_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the profile pins is set at every opening; the configuration's own wish for a control goes before it."""
    opened: list[Any] = []
    real_open = usb_mock.UsbMock.open

    def noting_open(self: usb_mock.UsbMock, options: usb_mock.UsbMockOptions, clock: ManualClock) -> object:
        opened.append(options)
        return real_open(self, options, clock)

    monkeypatch.setattr(usb_mock.UsbMock, "open", noting_open)
    options = {"recording": str(write_recording(tmp_path / "r", 2)), "pace": 0, "controls": {"gain": 7}}
    clock = ManualClock()
    table = PluginTable(plugin="usb_mock", options=options)
    opener = device_opener(table, {"gain": 0, "gamma": 140}, clock)
    for _ in range(2):
        opener().close()
    values = usb_mock.plugin.bench(opened[0]).sensor.controls.values
    assert (values["gain"], values["gamma"]) == (7, 140)
    assert opened[0] is opened[1]


def test_a_device_without_controls_is_left_alone(tmp_path: Path) -> None:
    """A recording has no camera to set."""
    table = PluginTable(plugin="recorded", options={"recording": str(write_recording(tmp_path / "r", 1))})
    device_opener(table, {"gain": 0}, ManualClock())().close()
