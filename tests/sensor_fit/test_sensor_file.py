"""A sensor's file: what calibration writes, a scene reads; every fault is named."""

from pathlib import Path

import numpy as np
import pytest
from ball_presses import UNSEEN

from calibration.simulator.field_of_view import LR
from calibration.simulator.renderer import Renderer
from calibration.simulator.scene import load_scene
from calibration.simulator.sensor_file import SensorFile, find_sensor, read_sensor
from edge.core.errors import ConfigError

SCENE = """version = 1
name = "mine"
part = "PZ3"
effects = ["deformation", "illumination"]
[camera]
sensor = "line/unseen.toml"
[nominal]
specimens = 1
"""


def rows(table: np.ndarray) -> list[list[float]]:
    return [list(row) for row in table.tolist()]


@pytest.fixture
def sensor() -> SensorFile:
    assert UNSEEN.height_response is not None
    return SensorFile.model_validate(
        {
            "version": 1,
            "name": "unseen",
            "free_gel": rows(UNSEEN.free_gel),
            "slope_response": rows(UNSEEN.slope_response),
            "height_response": rows(UNSEEN.height_response),
            "noise_sd": UNSEEN.noise_sd,
            "gel": {"short_mm": 0.4, "long_mm": 1.1, "long_share": 0.55},
        }
    )


@pytest.fixture
def file(sensor: SensorFile, tmp_path: Path) -> Path:
    path = tmp_path / "line" / "unseen.toml"
    path.parent.mkdir()
    path.write_text(sensor.to_toml())
    return path


def test_what_is_written_is_read(file: Path, sensor: SensorFile) -> None:
    assert read_sensor(file) == sensor


def test_a_scene_names_the_file_from_its_own_folder(file: Path) -> None:
    """The path is relative to the scene; the renderer takes colours, gel and noise from it."""
    scene = file.parents[1] / "mine.toml"
    scene.write_text(SCENE)
    seen = load_scene(scene).camera.appearance
    assert (seen.name, seen.gel, seen.noise_sd) == ("unseen", UNSEEN.gel, UNSEEN.noise_sd)
    drawn = [Renderer(LR, ("illumination",), one).free_gel() for one in (seen, UNSEEN)]
    assert np.array_equal(drawn[0], drawn[1])


def test_another_content_is_another_scene(file: Path, sensor: SensorFile) -> None:
    """A scene holds the content, so a run that was begun with another sensor is not continued."""
    scene = load_scene("small")
    other = sensor.model_copy(update={"noise_sd": (0.0, 0.0, 0.0)})
    assert scene.with_sensor(sensor) != scene.with_sensor(other)
    assert scene.with_sensor(sensor) == scene.with_sensor(find_sensor(str(file)))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("version = 1", "version = 2", "'version' is 2"),
        ("noise_sd", "noise_sdd", "did you mean 'noise_sd'?"),
        ("short_mm = 0.4", "short_mm = 4.0", "is not above long_mm"),
        ("free_gel = [\n  [4.94, ", "free_gel = [\n  [", "15 numbers (degree 4) or 28 (degree 6), found 14"),
        ("name =", "name ", "cannot be read"),
    ],
)
def test_a_faulty_file_is_refused(file: Path, old: str, new: str, sentence: str) -> None:
    """With the file, the key, and what was expected."""
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=r"unseen\.toml") as caught:
        read_sensor(file)
    assert sentence in str(caught.value)


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    """And it is said that files end in .toml."""
    with pytest.raises(ConfigError, match=r"did you mean 'unit_a'\?.*ends in \.toml"):
        find_sensor("unit_aa")
