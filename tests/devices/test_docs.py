"""The manual names every fault that a virtual sensor simulates, and the limit after which a sensor is opened again."""

import inspect
from pathlib import Path
from typing import get_args

from edge import acquisition
from plugins.devices.virtual.faults import FaultKind

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_every_fault_is_named() -> None:
    """Each kind is in the example of docs/simulator.md."""
    page = (DOCS / "simulator.md").read_text(encoding="utf-8")
    assert [kind for kind in get_args(FaultKind) if f'"{kind}@' not in page] == []


def test_numbers_are_the_programs() -> None:
    """docs/operations.md has the limit that is in the code."""
    stalled_s = inspect.signature(acquisition.Acquisition).parameters["stall_after_s"].default
    page = (DOCS / "operations.md").read_text(encoding="utf-8")
    assert f"after {stalled_s:g} s of nothing else the sensor is opened again" in page
