"""Scenes: descriptions of a simulation. One TOML file, its version on the first line, read into frozen values.

A scene names its effects; others are not computed. All faults of a file are reported at once, an unknown key with the
nearest known one.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import EFFECTS, check_effects
from calibration.simulator.motion import Motion
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Jitter
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from calibration.simulator.sensor_file import SensorFile, find_sensor
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion
from edge.validation_messages import numbered, sentences

__all__ = [
    "SCENES",
    "Camera",
    "Defects",
    "NominalPieces",
    "Scene",
    "SceneRun",
    "change_counts",
    "load_scene",
    "paper_scenes",
    "scene_names",
]

SCENES = Path(__file__).parent / "scenes"
"""The scenes that come with the product, known by their file names."""

Table = TypeVar("Table", "NominalPieces", "SceneRun")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Camera(_Table):
    """The frames."""

    modes: Annotated[tuple[Literal["lr", "hr", "native"], ...], Field(min_length=1)] = ("lr",)
    fps: Annotated[float, Field(gt=0, le=200)] = 18.75
    """Delivered; the real sensor manages these of its 25."""
    reduction: Literal[2, 4, 8] = 4
    sensor: str | SensorFile = "unit_b"
    """A name, or the content of a file, so that a scene is equal to another one only where its sensor is."""

    @field_validator("sensor")
    @classmethod
    def _check_sensor(cls, sensor: str | SensorFile) -> str | SensorFile:
        return _check_known(sensor, SENSORS, "sensor") if isinstance(sensor, str) else sensor

    @property
    def appearance(self) -> SensorAppearance:
        """The sensor's colours, gel and noise."""
        return SENSORS[self.sensor] if isinstance(self.sensor, str) else self.sensor.appearance


class NominalPieces(_Table):
    """A dataset's sound pieces: how many, and how often each is pressed at each position."""

    specimens: Annotated[int, Field(ge=1, le=10_000)]
    presses: Annotated[int, Field(ge=1, le=100)] = 10


class Defects(_Table):
    """The damage. `images`: pictures of damaged pieces over all positions (datasets)."""

    kinds: Annotated[tuple[str, ...], Field(min_length=1)] = tuple(DEFECTS)
    severity: tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]] = (0.3, 1.0)
    images: Annotated[int, Field(ge=0, le=10_000)] = 0

    @field_validator("kinds")
    @classmethod
    def _check_kinds(cls, kinds: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(_check_known(kind, DEFECTS, "defect") for kind in kinds)

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.severity[0] > self.severity[1]:
            raise ValueError(f"severity is [least, most], found {list(self.severity)}")
        return self


class SceneRun(_Table):
    """One recording of a scene: the number of presses, of damaged ones, and of earlier presses on the gel."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_-]+$", max_length=40)]
    presses: Annotated[int, Field(ge=1, le=100_000)]
    faulty: Annotated[int, Field(ge=0)] = 0
    gel_presses: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _not_all_faulty(self) -> Self:
        if self.faulty >= self.presses and self.faulty > 0:
            raise ValueError(
                f"the first press of a run is sound, so faulty is below presses, found {self.faulty}"
            )
        return self


class Scene(_Table):
    """The file. A scene has either `runs` (recordings) or `nominal` (a dataset)."""

    version: Literal[1]
    """1, on the first line."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=60)]
    """The scene's name."""
    part: str
    """PZ1 to PZ5."""
    positions: tuple[str, ...] = ()
    """Which of the part's positions; all by default."""
    effects: tuple[str, ...]
    """Those that are computed."""
    camera: Camera = Camera()
    """`modes`: `lr` (320x240), `hr` (1280x720), `native` (3280x2464, for recordings); `fps`; `reduction`: native frames
    are rendered at 1/2, 1/4 (default) or 1/8 and scaled up, for a gateway decodes them at that reduction; `sensor`:
    `unit_a`, `unit_b`, `unit_c`, or the path of a sensor's file, relative to the scene's."""
    motion: Motion = Motion()
    """`idle_s`, then for each press `approach_s`, `press_s`, `settle_s`, `hold_s`, `lift_s`, at the end
    `tail_s`."""
    depth_mm: Annotated[float, Field(gt=0, le=2)] | None = None
    """How deep a press goes; by default the part's own."""
    mask_depth_mm: Annotated[float, Field(gt=0, le=1)] = 0.02
    """An imprint that differs by more is masked; 0.02 by default."""
    jitter: Jitter | None = None
    """`shift_mm`, `turn_deg`, `tilt_deg`, `depth_fraction`: standard deviations in place of the part's."""
    nominal: NominalPieces | None = None
    """Datasets: `specimens`, and `presses` of each at each position."""
    defects: Defects = Defects()
    """`kinds`, `severity = [least, most]`, `images` (datasets: damaged pictures over all positions)."""
    runs: tuple[SceneRun, ...] = ()
    """Recordings: `name`, `presses`, `faulty`, `gel_presses` (how worn the gel is at the start)."""

    @field_validator("part")
    @classmethod
    def _check_part(cls, name: str) -> str:
        return _check_known(name, PARTS, "part")

    @field_validator("effects")
    @classmethod
    def _check_effects(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        check_effects(names)
        return tuple(name for name in EFFECTS if name in names)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for position in self.positions:
            _check_known(position, PARTS[self.part].positions, f"position of {self.part}")
        if len(set(self.positions)) != len(self.positions):
            raise ValueError(f"positions are different, found {list(self.positions)}")
        if len(set(self.camera.modes)) != len(self.camera.modes):
            raise ValueError(f"camera modes are different, found {list(self.camera.modes)}")
        if bool(self.runs) == bool(self.nominal):
            raise ValueError("a scene has either [[runs]] (recordings) or [nominal] (a dataset)")
        if self.runs and len(self.camera.modes) != 1:
            raise ValueError(f"a recording has one camera mode, found {list(self.camera.modes)}")
        if self.nominal and "native" in self.camera.modes:
            raise ValueError("a dataset has the camera modes lr and hr, found native")
        if self.nominal and "residual_imprint" in self.effects:
            raise ValueError(
                "a dataset's presses are single pictures without a press before, so 'residual_imprint' has no effect; "
                "leave it out of `effects`, or describe recordings with [[runs]]"
            )
        if len({run.name for run in self.runs}) != len(self.runs):
            raise ValueError(f"runs have different names, found {[run.name for run in self.runs]}")
        return self

    @property
    def at(self) -> tuple[str, ...]:
        """The positions, all of the part's where the scene names none."""
        return self.positions or tuple(PARTS[self.part].positions)

    def with_sensor(self, sensor: str | SensorFile) -> Self:
        """Copy the scene, seen by another sensor."""
        return self.model_copy(update={"camera": self.camera.model_copy(update={"sensor": sensor})})

    @property
    def press_depth_mm(self) -> float:
        """The depth of a press: the scene's own, or the part's."""
        return PARTS[self.part].depth_mm if self.depth_mm is None else self.depth_mm

    @property
    def press_jitter(self) -> Jitter:
        """The differences of presses: the scene's own, or the part's."""
        return self.jitter or PARTS[self.part].jitter


def _check_known(name: str, known: Mapping[str, object], what: str) -> str:
    if name in known:
        return name
    raise ValueError(f"no {what} is named '{name}'; {suggestion(name, known)}")


def paper_scenes() -> list[Scene]:
    """The scenes that together have the counts of the published dataset (its Table 1): PZ1 to PZ5."""
    return [load_scene(path) for path in sorted((SCENES / "paper").glob("*.toml"))]


def change_counts(table: Table, **counts: int) -> Table:
    """A scene's table with other numbers, checked against the same limits. Errors: ConfigError."""
    try:
        return type(table).model_validate({**table.model_dump(), **counts})
    except ValidationError as error:
        raise ConfigError("; ".join(sentences(type(table), error))) from None


def scene_names() -> list[str]:
    """The scenes that come with the product, such as `demo` or `paper/pz1`."""
    return sorted(path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.toml"))


def load_scene(name_or_path: str | Path) -> Scene:
    """A scene by its name or its file. Errors: ConfigError with one line for every fault found."""
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = SCENES / f"{name_or_path}.toml"
        if not path.is_file():
            hint = suggestion(str(name_or_path), scene_names())
            raise ConfigError(f"no scene is named '{name_or_path}'; {hint} (a file's name ends in .toml)")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return Scene.model_validate(_with_sensor(table, path.parent))
    except ValidationError as error:
        raise ConfigError(numbered(f"scene {path}", sentences(Scene, error))) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"scene {path} cannot be read: {error}") from error


def _with_sensor(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with the content of the sensor's file, where it names one. Errors: ConfigError."""
    camera = table.get("camera")
    if not isinstance(camera, dict) or not str(camera.get("sensor", "")).endswith(".toml"):
        return table
    return {**table, "camera": {**camera, "sensor": find_sensor(str(camera["sensor"]), folder)}}
