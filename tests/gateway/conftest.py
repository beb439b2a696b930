"""A station of recorded presses: its configuration, and the station stepped by the test."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from shadow_station import few, shadowed
from station import Configure, bundle, recording, station_config
from stepped_station import SteppedStation

__all__ = ["bundle", "few", "recording", "shadowed"]


@pytest.fixture
def configure(tmp_path: Path, recording: Path, bundle: Path) -> Configure:
    return partial(station_config, tmp_path, recording, bundle)


@pytest.fixture
def config(tmp_path: Path, recording: Path, bundle: Path) -> Path:
    return station_config(tmp_path, recording, bundle)


@pytest.fixture
def station(config: Path) -> Iterator[SteppedStation]:
    with SteppedStation(config) as stepped:
        yield stepped
