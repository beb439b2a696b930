"""A station with a shadow: its configuration, and the request that lets the shadow take over."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from station import mark_tried, station_config
from stepped_station import SteppedStation

FIVE = {
    "alpha": 0.2,
    "alpha_floor": 0.2,
    "nominal_scores": [0.01, 0.02, 0.03, 0.04, 0.05],
    "method": "held out",
}

Shadowed = Callable[..., Path]


@pytest.fixture
def shadowed(tmp_path: Path, recording: Path) -> Shadowed:
    """Write a configuration with the bundle that inspects and its shadows."""

    def write(bundle: Path, *shadows: Path, folder: str = "station") -> Path:
        named = ", ".join(f'"{path}"' for path in shadows)
        config = station_config(tmp_path / folder, recording, f'bundle = "{bundle}"\nshadows = [{named}]')
        mark_tried(tmp_path / folder / "gelgate.db", *(one for one in (bundle, *shadows) if one.is_dir()))
        return config

    return write


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """One press that both have judged is enough for a takeover."""
    monkeypatch.setattr("edge.core.shadow.LEAST_COMPARED", 1)


def adopt(station: SteppedStation) -> Any:
    """Ask as a requester's thread does, and let the loop take a turn."""
    data = station.ask("adopt_shadow")()
    station.turn()
    return data


def restore(station: SteppedStation) -> Any:
    """Ask for the configured bundle in the same way."""
    data = station.ask("restore_bundle")()
    station.turn()
    return data
