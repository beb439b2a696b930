"""A height map as a file: PNG for people and programs, NPZ for numpy, X3P (ISO 25178-72) for metrology programs.

And a gel's calibration of heights, as `gelgate lab calibrate --heights` writes it: one TOML file.
"""

import hashlib
import io
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from xml.sax.saxutils import escape

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from edge.core.errors import ConfigError
from edge.core.heights.calibration import HeightCalibration
from edge.core.heights.height_map import HeightMap
from edge.core.printable import toml_string
from edge.pictures.image_file import encode
from edge.validation_messages import numbered, sentences

__all__ = ["FORMS", "check_form", "encode_heights", "read_calibration", "write_calibration"]

_STEPS: Final = np.iinfo(np.uint16).max


def check_form(path: Path) -> None:
    """Check the name of a file to write. Errors: ConfigError."""
    if path.suffix.lower() not in FORMS:
        raise ConfigError(
            f"heights are written as {', '.join(FORMS)}, found '{path.name}'; choose one of these endings"
        )


def encode_heights(heights: HeightMap, source: str, time: str, suffix: str) -> bytes:
    """Return the file. source: the press. time: ISO 8601."""
    return FORMS[suffix.lower()](heights, source, time)


def _png(heights: HeightMap, source: str, time: str) -> bytes:
    """Grey levels of 16 bits: a value v stands for the height `zero_mm + step_mm v`."""
    mm = heights.heights_mm.astype(np.float64)
    zero = float(mm.min())
    step = (float(mm.max()) - zero) / _STEPS or 1.0
    scale = {"zero_mm": f"{zero:.9g}", "step_mm": f"{step:.9g}"}
    return encode(np.rint((mm - zero) / step).astype(np.uint16), {**_facts(heights, source, time), **scale})


def _npz(heights: HeightMap, source: str, time: str) -> bytes:
    """Arrays `heights_mm`, `u95_mm`, `touched`, and the facts as scalars."""
    made = io.BytesIO()
    arrays: dict[str, Any] = {name: np.array(value) for name, value in _facts(heights, source, time).items()}
    arrays |= {"heights_mm": heights.heights_mm, "u95_mm": heights.u95_mm, "touched": heights.touched}
    np.savez_compressed(made, **(arrays | {"mm_per_px": np.array(heights.mm_per_px)}))
    return made.getvalue()


def _facts(heights: HeightMap, source: str, time: str) -> Mapping[str, str]:
    calibration = heights.calibration
    share = calibration.height_u95 + 2 * calibration.scale_u95
    return {
        "source": source,
        "time": time,
        "mm_per_px": f"{heights.mm_per_px:.6g}",
        "calibration": calibration.name,
        "u95": f"{calibration.floor_u95_mm:.3g} mm + {share:.2g} of a height",
    }


_X3P = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{step}</Increment><Offset>0</Offset></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{step}</Increment><Offset>0</Offset></CY>
<CZ><AxisType>A</AxisType><DataType>F</DataType><Increment>1</Increment><Offset>0</Offset></CZ></Axes></Record1>
<Record2><Date>{time}</Date><Instrument><Manufacturer>GelSight</Manufacturer><Model>Mini, read by gelgate</Model>
<Serial>{serial}</Serial><Version>not available</Version></Instrument><CalibrationDate>{calibrated}</CalibrationDate>
<ProbingSystem><Type>NonContacting</Type><Identification>{calibration}</Identification></ProbingSystem>
<Comment>{comment}</Comment></Record2>
<Record3><MatrixDimension><SizeX>{columns}</SizeX><SizeY>{rows}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink><PointDataLink>bindata/data.bin</PointDataLink><MD5ChecksumPointData>{md5}</MD5ChecksumPointData></DataLink>
</Record3><Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>
"""


def _x3p(heights: HeightMap, source: str, time: str) -> bytes:
    """Heights in metres, float32, row by row; the first row is the top of the picture."""
    data = (heights.heights_mm / np.float32(1000)).astype("<f4").tobytes()
    rows, columns = heights.heights_mm.shape
    calibration = heights.calibration
    document = _X3P.format(
        step=repr(heights.mm_per_px / 1000),
        time=escape(time),
        calibrated=f"{calibration.made_on or date.min}T00:00:00Z",  # the format needs one
        serial=escape(calibration.serial or "not available"),
        calibration=escape(calibration.name),
        comment=escape(f"{source}; 95 % uncertainty {_facts(heights, source, time)['u95']}"),
        columns=columns,
        rows=rows,
        md5=hashlib.md5(data, usedforsecurity=False).hexdigest().upper(),
    ).encode()
    checksum = f"{hashlib.md5(document, usedforsecurity=False).hexdigest()} *main.xml\n".encode()
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (
            ("main.xml", document),
            ("bindata/data.bin", data),
            ("md5checksum.hex", checksum),
        ):
            # A fixed time: equal heights give equal bytes.
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return made.getvalue()


FORMS: Final[Mapping[str, Callable[[HeightMap, str, str], bytes]]] = {
    ".png": _png,
    ".npz": _npz,
    ".x3p": _x3p,
}
"""How a height map is written, by the end of the file's name."""


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
    lines = ["version = 1", 'kind = "heights"', f"name = {toml_string(made.name)}"]
    lines += [] if made.serial is None else [f"serial = {toml_string(made.serial)}"]
    lines += [] if made.made_on is None else [f"made_on = {made.made_on}"]
    for key in ("mm_per_px", "scale_u95", "floor_u95_mm", "height_u95", "noise_mm"):
        lines.append(f"{key} = {getattr(made, key):.5g}")
    for key, digits in zip(_ARRAYS, (3, 4, 1), strict=True):
        rows = "\n".join(f"  {row}," for row in getattr(made, key).round(digits).tolist())
        lines.append(f"{key} = [\n{rows}\n]")
    return "\n".join(lines) + "\n"
