"""`gelgate station heights`: the height map of a press in millimetres, as a file, and the roughness of a region."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.config import load_config
from edge.core.arrays import U8
from edge.core.defects import longest_extent
from edge.core.errors import ConfigError, FrameCorrupt, HeightError, RecordingError
from edge.core.heights.calibration import SIZE, HeightCalibration
from edge.core.heights.height_map import HeightMap, find_touched, free_picture, measure_heights
from edge.core.heights.roughness import CUT_OFFS_MM, measure_roughness
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import PROFILES
from edge.core.imaging.region import Region
from edge.core.printable import printable
from edge.heights.files import check_form, encode_heights, read_calibration
from edge.messaging.payload_base import iso_time
from edge.recording.format import Recording
from edge.recording.presses_in import find_settled
from edge.store.history import find_press
from edge.store.press_archive import ArchiveFolder

__all__ = ["heights"]

_UNCALIBRATED: Final = (
    "this sensor is not calibrated, so nothing of it can be said in millimetres; make a calibration with `gelgate lab "
    "calibrate --heights`, and name it with --calibration or as `gel.heights`"
)


def heights(
    press: Annotated[
        str,
        typer.Argument(
            metavar="PRESS", help="An archived press by number or id, a picture, or a recording's folder."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write the map: a name ending in .png, .npz or .x3p."),
    ] = None,
    number: Annotated[int, typer.Option(min=1, help="Which press at rest of a recording.")] = 1,
    free: Annotated[
        Path | None, typer.Option(help="A picture of the free gel, where PRESS is a picture.")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="The gel's file of `gelgate lab calibrate --heights`; default: `gel.heights`."),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(help="Print the roughness of this part of the picture of 320x240: x,y,WIDTHxHEIGHT."),
    ] = None,
    cut_off_mm: Annotated[float, typer.Option(help="Of roughness: 0.8 or 2.5.")] = 0.8,
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    archive: Annotated[
        Path | None, typer.Option(help="The folder of archived presses; next to the database by default.")
    ] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Measure a press in millimetres.

    Without a calibration in pixels. Writes how far each place of the gel is raised above the free gel, with its
    uncertainty; docs/heights.md says what a gel can show, and how well. .png: 16 bits, with its scale as text; .npz:
    for numpy; .x3p: ISO 25178-72.
    """
    _check_words(output, cut_off_mm, overwrite=overwrite)
    part = None if region is None else Region.parse(region, SIZE)
    made_with = _find_calibration(calibration, config, is_needed=output is not None or part is not None)
    shown = _read_press(press, number, free, lambda: database_path(config, database), archive)
    if made_with is None:
        _say_pixels(shown)
        return
    height_map = measure_heights(shown.rgb, shown.free_rgb, made_with, shown.serial)
    _say(height_map)
    if part is not None:
        for roughness in measure_roughness(height_map, part, cut_off_mm):
            typer.echo(str(roughness))
    if output is not None:
        output.write_bytes(encode_heights(height_map, shown.source, iso_time(shown.time_ns), output.suffix))
        typer.echo(printable(f"written: {output}"))


def _check_words(output: Path | None, cut_off_mm: float, *, overwrite: bool) -> None:
    """Errors: ConfigError, HeightError before any work is done."""
    if output is not None:
        check_form(output)
        if output.exists() and not overwrite:
            raise ConfigError(f"{output} exists; name another file, or replace it with --overwrite")
    if cut_off_mm not in CUT_OFFS_MM:
        raise HeightError(
            f"a cut-off is {' or '.join(f'{one:g}' for one in CUT_OFFS_MM)} mm, found {cut_off_mm:g}: shorter waves a "
            "gel does not show, longer ones do not fit into it"
        )


def _find_calibration(named: Path | None, config: Path, *, is_needed: bool) -> HeightCalibration | None:
    """Find the calibration that is named, else the station's; None without one, an error where one is needed.

    Errors: ConfigError.
    """
    path = named or (load_config(config).gel.heights if config.exists() else None)
    if path is None and is_needed:
        raise ConfigError(f"{_UNCALIBRATED}; without -o and --region it is measured in pixels")
    return None if path is None else read_calibration(path)


class _Shown(NamedTuple):
    """A press and its free gel, uint8 (240, 320, 3) each, of the sensor, from where, and when, Unix time."""

    rgb: U8
    free_rgb: U8
    serial: str | None
    source: str
    time_ns: int


def _read_press(
    press: str, number: int, free: Path | None, find_database: Callable[[], Path], archive: Path | None
) -> _Shown:
    """Read a press from a recording's folder, from a picture, or from the archive. Errors: GelgateError."""
    if Path(press).is_dir():
        return _read_recorded(Path(press), number)
    if Path(press).is_file():
        if free is None:
            raise ConfigError(f"{press} is a picture; give one of the free gel with --free")
        return _Shown(_read_picture(Path(press)), _read_picture(free), None, press, time.time_ns())
    if Path(press).name != press or Path(press).suffix:  # no press_id
        raise ConfigError(
            f"{press} does not exist; name a picture, a recording's folder, or an archived press"
        )
    return _read_archived(press, find_database(), archive)


def _read_picture(path: Path) -> U8:
    """Read a picture of the camera's size, or of 320x240 as the maker crops it. Errors: HeightError."""
    try:
        return _decode(path.read_bytes(), str(path))
    except OSError as error:
        raise HeightError(f"{path} cannot be read: {error.strerror}; name a JPEG or PNG") from error


def _decode(payload: bytes, name: str) -> U8:
    frame = CameraFrame(payload, 0, 0)
    known = {PROFILES[profile].native: PROFILES[profile] for profile in ("mini_lr", "cropped_lr")}
    if frame.size not in known:
        size_text = "no picture" if frame.size is None else "{}x{}".format(*frame.size)
        raise HeightError(
            f"{name} is {size_text}; heights are measured in the camera's 3280x2464, or in the maker's crop of 320x240"
        )
    try:
        return decode(frame, known[frame.size])
    except FrameCorrupt as error:
        raise HeightError(f"{name}: {error}") from error


def _read_archived(prefix: str, database: Path, archive: Path | None) -> _Shown:
    """Read a press of the archive. Errors: ArchiveError, HeightError."""
    known = find_press(database, prefix)
    folder = ArchiveFolder(archive or database.with_suffix(".archive"))
    then = folder.press(known.press_id, known.evidence)
    view = folder.read_reference(then)
    if view is None:
        raise HeightError(
            f"press {then.press_id} has no free gel in the archive, for it was judged before one was learnt; "
            "choose a later press"
        )
    frame = folder.read(then.frame, f"the judged frame of press {then.press_id}")
    rgb = _decode(frame, f"press {then.press_id}")
    return _Shown(rgb, free_picture(view), then.serial, then.press_id, then.time_ns)


def _read_recorded(folder: Path, number: int) -> _Shown:
    """Read a press of a recording. Errors: RecordingError, HeightError."""
    recording = Recording.open(folder)
    settled = find_settled(recording, number)
    if settled.frame is None or settled.findings is None:
        raise RecordingError(f"press {number} of recording {folder} has no frame; choose another")
    name = f"{folder}, press {number}"
    rgb, free_rgb = _decode(settled.frame.payload, name), free_picture(settled.findings.free)
    return _Shown(rgb, free_rgb, recording.header.serial, name, time.time_ns())


def _say_pixels(shown: _Shown) -> None:
    touched = find_touched(shown.rgb, shown.free_rgb)[1]
    typer.echo(
        f"{int(touched.sum())} pixels touched, {longest_extent(touched):.0f} from end to end, in the picture of 320x240"
    )
    typer.echo(_UNCALIBRATED)


def _say(found: HeightMap) -> None:
    highest = float(found.heights_mm.max())
    u95 = float(found.u95_mm.flat[int(found.heights_mm.argmax())])
    area = float(found.touched.sum()) * found.mm_per_px**2
    typer.echo(
        f"highest {highest:.3f} mm, +- {u95:.3f} mm (95 %); {area:.1f} mm2 touched; "
        f"{found.mm_per_px:.4f} mm per pixel, +- {found.calibration.scale_u95:.0%}"
    )
