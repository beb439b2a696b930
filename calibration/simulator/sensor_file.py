"""A sensor's file: the colours, gel and noise of one sensor, as `gelgate lab calibrate` writes it and a scene names it.

One TOML file, `version = 1` on its first line. Columns and units are those of `SensorAppearance`.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from calibration.simulator.gel import Gel
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion
from edge.validation_messages import numbered, sentences

__all__ = ["Fitted", "SensorFile", "find_sensor", "read_sensor"]


def _polynomial(row: tuple[float, ...]) -> tuple[float, ...]:
    if len(row) not in (15, 28):
        raise ValueError(f"a row has 15 numbers (degree 4) or 28 (degree 6), found {len(row)}")
    return row


_Row = tuple[float, ...]
_Row15 = Annotated[tuple[float, ...], Field(min_length=15, max_length=15)]
_FreeRow = Annotated[_Row, AfterValidator(_polynomial)]
_Row6 = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]
_Level = Annotated[float, Field(ge=0, le=30)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Fitted(_Table):
    """What the numbers were fitted to, and how good they are: errors in grey levels rms, of presses held out."""

    presses: Annotated[int, Field(ge=1)]
    ball_radius_mm: Annotated[float, Field(gt=0)]
    mm_per_px: Annotated[float, Field(gt=0)]
    inside_levels: Annotated[float, Field(ge=0)]
    outside_levels: Annotated[float, Field(ge=0)]
    has_markers: bool = False


class SensorFile(_Table):
    """One sensor. Rows are red, green and blue."""

    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=60)]
    free_gel: tuple[_FreeRow, _FreeRow, _FreeRow]
    slope_response: tuple[_Row15, _Row15, _Row15]
    height_response: tuple[_Row6, _Row6, _Row6]
    noise_sd: tuple[_Level, _Level, _Level]
    gel: Gel
    fitted: Fitted | None = None

    @model_validator(mode="after")
    def _one_degree(self) -> Self:
        if len({len(row) for row in self.free_gel}) > 1:
            raise ValueError("the three rows of free_gel have equal lengths")
        return self

    @classmethod
    def of(cls, seen: SensorAppearance, fitted: Fitted) -> Self:
        """Return the file of a fitted sensor, with as many digits as its fit is worth."""
        assert seen.height_response is not None
        gel = Gel(*(round(value, 3) for value in (seen.gel.short_mm, seen.gel.long_mm, seen.gel.long_share)))
        tables = {
            "free_gel": seen.free_gel.round(4),
            "slope_response": seen.slope_response.round(2),
            "height_response": seen.height_response.round(2),
            "noise_sd": np.round(seen.noise_sd, 2),
        }
        rows = {name: table.tolist() for name, table in tables.items()}
        return cls.model_validate({"version": 1, "name": seen.name, **rows, "gel": gel, "fitted": fitted})

    @property
    def appearance(self) -> SensorAppearance:
        """Give it as the renderer takes it."""
        return SensorAppearance(
            self.name,
            np.array(self.free_gel, dtype=np.float64),
            np.array(self.slope_response, dtype=np.float64),
            np.array(self.height_response, dtype=np.float64),
            self.gel,
            self.noise_sd,
        )

    def to_toml(self) -> str:
        """The file's text."""
        lines = [f"version = {self.version}", f'name = "{self.name}"']
        for key in ("free_gel", "slope_response", "height_response"):
            rows = "\n".join(f"  {list(row)}," for row in getattr(self, key))
            lines.append(f"{key} = [\n{rows}\n]")
        lines.append(f"noise_sd = {list(self.noise_sd)}")
        for key, table in self.model_dump(include={"gel", "fitted"}, exclude_none=True).items():
            lines.append(f"\n[{key}]")
            lines += [f"{name} = {str(value).lower()}" for name, value in table.items()]
        return "\n".join(lines) + "\n"


def read_sensor(path: Path) -> SensorFile:
    """A sensor's file. Errors: ConfigError with one line for every fault found."""
    try:
        return SensorFile.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        raise ConfigError(numbered(f"sensor {path}", sentences(SensorFile, error))) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"sensor {path} cannot be read: {error}") from error


def find_sensor(name_or_path: str, folder: Path = Path()) -> str | SensorFile:
    """The name of a sensor that comes with the product, or the content of a file; its path is relative to `folder`.

    Errors: ConfigError with the nearest known name.
    """
    if name_or_path.endswith(".toml"):
        return read_sensor(folder / name_or_path)
    if name_or_path in SENSORS:
        return name_or_path
    raise ConfigError(
        f"no sensor is named '{name_or_path}'; {suggestion(name_or_path, SENSORS)} (a file's name ends in .toml)"
    )
