"""Simulated presses of a tactile sensor: parts and defects as geometry, effects one by one, exact masks.

From Python: `from calibration.simulator import PARTS, Renderer`; docs/simulator.md has an example.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.simulator.defects import place_defect
    from calibration.simulator.effects import DEFAULT_EFFECTS
    from calibration.simulator.field_of_view import HR, LR
    from calibration.simulator.parts import PARTS
    from calibration.simulator.renderer import Renderer
    from calibration.simulator.streams import named_streams

_HOMES = {
    "DEFAULT_EFFECTS": "effects",
    "HR": "field_of_view",
    "LR": "field_of_view",
    "PARTS": "parts",
    "Renderer": "renderer",
    "named_streams": "streams",
    "place_defect": "defects",
}

__all__ = ["DEFAULT_EFFECTS", "HR", "LR", "PARTS", "Renderer", "named_streams", "place_defect"]


def __getattr__(name: str) -> Any:
    """Imported at use: the command line imports this package for its help."""
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
