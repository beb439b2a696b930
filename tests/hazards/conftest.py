"""Every test in this folder carries the marker `hazards`: `pytest -m hazards` runs only H1 to H20."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.parent == FOLDER:
            item.add_marker(pytest.mark.hazards)
