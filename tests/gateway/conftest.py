"""A station of recorded presses: its configuration, and the station stepped by the test."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from station import bundle, recording, station_config
from stepped_station import SteppedStation

__all__ = ["bundle", "recording"]


@pytest.fixture
def config(tmp_path: Path, recording: Path, bundle: Path) -> Path:
    return station_config(tmp_path, recording, bundle)


@pytest.fixture
def station(config: Path) -> Iterator[SteppedStation]:
    with SteppedStation(config) as stepped:
        yield stepped
