"""Simulated presses of a tactile sensor: parts and defects as geometry, effects one by one, exact masks.

The library's door. `Renderer` makes single pictures for training and tests; `calibration.simulate` makes recordings
and datasets from scenes.
"""

from calibration.simulator.defects import DEFECTS, Damaged, Defect, place_defect
from calibration.simulator.effects import DEFAULT_EFFECTS, EFFECTS
from calibration.simulator.field import HR, LR, Field, native_field
from calibration.simulator.look import LOOKS, Look, random_look
from calibration.simulator.parts import PARTS, Part, specimen
from calibration.simulator.pose import HeightField, Jitter, Pose
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.streams import Streams, named_streams

__all__ = [
    "DEFAULT_EFFECTS",
    "DEFECTS",
    "EFFECTS",
    "HR",
    "LOOKS",
    "LR",
    "PARTS",
    "Damaged",
    "Defect",
    "Exposure",
    "Field",
    "HeightField",
    "Jitter",
    "Look",
    "Part",
    "Pose",
    "Renderer",
    "Streams",
    "named_streams",
    "native_field",
    "place_defect",
    "random_look",
    "specimen",
]
