"""A gel's calibration of heights, as `gelgate lab calibrate --heights` writes it: one TOML file."""

import tomllib
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from edge.core.errors import ConfigError
from edge.core.heights.calibration import HeightCalibration
from edge.validation_messages import numbered, sentences

__all__ = ["read_calibration", "write_calibration"]

_Six = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]
_Terms = Annotated[tuple[_Six, ...], Field(min_length=6, max_length=6)]
_Colour = tuple[float, float, float]
_Row = Annotated[tuple[_Colour, ...], Field(min_length=8, max_length=8)]
_Share = Annotated[float, Field(ge=0, le=1)]


class _File(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """Fields and units are those of `HeightCalibration`."""

    version: Literal[1]
    kind: Literal["heights"]
    name: Annotated[str, Field(min_length=1, max_length=128)]
    serial: str | None = None
    made_on: date | None = None
    mm_per_px: Annotated[float, Field(gt=0, le=1)]
    scale_u95: _Share
    floor_u95_mm: Annotated[float, Field(ge=0, le=10)]
    height_u95: _Share
    noise_mm: Annotated[float, Field(ge=0, le=10)]
    response: tuple[_Terms, _Terms, _Terms]
    rest: tuple[_Colour, _Colour, _Colour]
    free_levels: Annotated[tuple[_Row, ...], Field(min_length=6, max_length=6)]


_ARRAYS = ("response", "rest", "free_levels")


def read_calibration(path: Path) -> HeightCalibration:
    """Read a calibration. Errors: ConfigError with one line for every fault found."""
    try:
        read = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
        values: dict[str, Any] = read.model_dump(exclude={"version", "kind"})
        values |= {name: np.array(values[name], np.float64) for name in _ARRAYS}
        return HeightCalibration(**values)
    except ValidationError as error:
        raise ConfigError(numbered(f"calibration {path}", sentences(_File, error))) from None
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"calibration {path} cannot be read: {error}; `gelgate lab calibrate --heights` makes one"
        ) from error


def write_calibration(made: HeightCalibration) -> str:
    """Return the file's text, with as many digits as a fit is worth."""
    lines = ["version = 1", 'kind = "heights"', f'name = "{made.name}"']
    lines += [] if made.serial is None else [f'serial = "{made.serial}"']
    lines += [] if made.made_on is None else [f"made_on = {made.made_on}"]
    for key in ("mm_per_px", "scale_u95", "floor_u95_mm", "height_u95", "noise_mm"):
        lines.append(f"{key} = {getattr(made, key):.5g}")
    for key, digits in zip(_ARRAYS, (3, 4, 1), strict=True):
        rows = "\n".join(f"  {row}," for row in getattr(made, key).round(digits).tolist())
        lines.append(f"{key} = [\n{rows}\n]")
    return "\n".join(lines) + "\n"
