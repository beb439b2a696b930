"""Simulated presses of a tactile sensor: parts and defects as geometry, effects one by one, exact masks.

From Python: `from calibration.simulator import PARTS, Renderer`; docs/simulator.md has an example.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.simulator.defects import place_defect
    from calibration.simulator.effects import DEFAULT_EFFECTS
    from calibration.simulator.field_of_view import HR, LR
    from calibration.simulator.parts import PARTS
    from calibration.simulator.renderer import Renderer
    from calibration.simulator.streams import Streams

__all__ = ["DEFAULT_EFFECTS", "HR", "LR", "PARTS", "Renderer", "Streams", "place_defect"]


def __getattr__(name: str) -> Any:
    """Imported at use: the command line imports this package for its help."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from calibration.simulator import defects, effects, field_of_view, parts, renderer, streams

    homes = (defects, effects, field_of_view, parts, renderer, streams)
    return next(getattr(home, name) for home in homes if hasattr(home, name))
