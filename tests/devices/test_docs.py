"""docs/sensors.md names every plugin, option and fault."""

from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from edge import acquisition
from plugins.devices import gelsight_mini, recorded, usb_mock
from plugins.devices.virtual.faults import FaultKind

PAGE = (Path(__file__).resolve().parents[2] / "docs/sensors.md").read_text()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("gelsight_mini", gelsight_mini.GelsightMiniOptions),
        ("usb_mock", usb_mock.UsbMockOptions),
        ("recorded", recorded.RecordedOptions),
    ],
)
def test_every_option_is_in_its_plugins_row(name: str, options: type[BaseModel]) -> None:
    """No option is undocumented."""
    (row,) = (line for line in PAGE.splitlines() if line.startswith(f"| `{name}`"))
    assert [option for option in options.model_fields if f"`{option}`" not in row] == []


def test_every_fault_is_named() -> None:
    """Each kind is in the example."""
    assert [kind for kind in get_args(FaultKind) if f'"{kind}@' not in PAGE] == []


def test_numbers_are_the_programs() -> None:
    """The limits on the page are those in the code."""
    assert f"after {acquisition._CORRUPT_IN_A_ROW} in a row" in PAGE
