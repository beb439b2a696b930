"""The manual names everything that a scene can name."""

import textwrap
from pathlib import Path
from typing import Any

from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import EFFECTS
from calibration.simulator.motion import Motion
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Jitter
from calibration.simulator.scene import (
    Camera,
    Defects,
    NominalPieces,
    Scene,
    SceneRun,
    scene_names,
)
from calibration.simulator.sensor_appearance import SENSORS

MANUAL = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()


def test_every_name_that_a_scene_can_use_is_in_the_manual() -> None:
    """Parts, defects, effects, sensors, the shipped scenes, and each field of each table as it is spelled there."""
    models = (Scene, Camera, Motion, NominalPieces, Defects, SceneRun)
    keys = {key for model in models for key in model.model_fields} | set(Jitter.__annotations__) - {"version"}
    names = [*PARTS, *DEFECTS, *EFFECTS, *SENSORS, *scene_names(), *sorted(keys)]
    assert [name for name in names if name not in MANUAL] == []


def test_the_example_in_python_runs() -> None:
    """A press, and a damaged press with its mask and the sound one."""
    code = textwrap.dedent(MANUAL.partition("From Python:\n\n")[2].partition("\n\n`")[0])
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["rgb"].shape == found["damaged"].shape == (240, 320, 3)
    assert found["mask"].any()
