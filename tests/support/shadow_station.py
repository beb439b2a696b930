"""A station with a shadow: its configuration, and the request that lets the shadow take over."""

import json
from pathlib import Path
from typing import Any

from station import mark_tried, station_config
from stepped_station import SteppedStation

FIVE = {
    "alpha": 0.2,
    "alpha_floor": 0.2,
    "nominal_scores": [0.01, 0.02, 0.03, 0.04, 0.05],
    "method": "held out",
}


def limit(bundle: Path, **changes: Any) -> dict[str, Any]:
    """The bundle's threshold with these changes."""
    threshold: dict[str, Any] = json.loads((bundle / "manifest.json").read_text())["threshold"]
    return threshold | changes


def configure(folder: Path, presses: Path, bundle: Path, *shadows: Path) -> Path:
    named = ", ".join(f'"{path}"' for path in shadows)
    config = station_config(folder, presses, f'bundle = "{bundle}"\nshadows = [{named}]')
    mark_tried(folder / "gelgate.db", *(one for one in (bundle, *shadows) if one.is_dir()))
    return config


def adopt(station: SteppedStation) -> Any:
    """Ask as a requester's thread does, and let the loop take a turn."""
    data = station.ask("adopt_shadow")()
    station.turn()
    return data
