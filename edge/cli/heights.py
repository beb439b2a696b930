"""`gelgate station heights`: the height map of a press in millimetres, as a file, and the roughness of a region."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.core.printable import printable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edge.core.heights.height_map import HeightMap

    U8 = NDArray[np.uint8]

__all__ = ["heights"]


def heights(
    press: Annotated[str, typer.Argument(metavar="PRESS", help="An archived press_id, or a picture.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="A name ending in .png, .npz or .x3p.")],
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

    Writes how far each place of the gel is raised above the free gel, with its uncertainty; docs/heights.md says what
    a gel can show, and how well. .png: 16 bits, with its scale as text; .npz: for numpy; .x3p: ISO 25178-72.
    """
    from edge.core.errors import ConfigError
    from edge.core.heights.calibration import SIZE
    from edge.core.heights.height_map import measure_heights
    from edge.core.heights.roughness import measure_roughness
    from edge.core.imaging.region import Region
    from edge.heights.calibration_file import read_calibration
    from edge.heights.files import encode_heights
    from edge.messaging.payload_base import iso_time

    _check_words(output, cut_off_mm, overwrite=overwrite)
    part = None if region is None else Region.parse(region, SIZE)
    made_with = read_calibration(calibration or _configured(config))
    if Path(press).is_file():
        if free is None:
            raise ConfigError(f"{press} is a picture; give one of the free gel with --free")
        rgb, free_rgb, serial, source, time_ns = (
            _picture(Path(press)),
            _picture(free),
            None,
            press,
            time.time_ns(),
        )
    else:
        rgb, free_rgb, serial, source, time_ns = _archived(press, database_path(config, database), archive)
    found = measure_heights(rgb, free_rgb, made_with, serial)
    _say(found)
    if part is not None:
        for one in measure_roughness(found, part, cut_off_mm):
            typer.echo(str(one))
    output.write_bytes(encode_heights(found, source, iso_time(time_ns), output.suffix))
    typer.echo(printable(f"written: {output}"))


def _check_words(output: Path, cut_off_mm: float, *, overwrite: bool) -> None:
    """Errors: ConfigError, HeightError before any work is done."""
    from edge.core.errors import ConfigError, HeightError
    from edge.core.heights.roughness import CUT_OFFS_MM
    from edge.heights.files import check_form

    check_form(output)
    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists; name another file, or replace it with --overwrite")
    if cut_off_mm not in CUT_OFFS_MM:
        raise HeightError(
            f"a cut-off is {' or '.join(f'{one:g}' for one in CUT_OFFS_MM)} mm, found {cut_off_mm:g}: shorter waves a "
            "gel does not show, longer ones do not fit into it"
        )


def _configured(config: Path) -> Path:
    """The station's calibration. Errors: ConfigError."""
    from edge.config import load_config
    from edge.core.errors import ConfigError

    path = load_config(config).gel.heights if config.exists() else None
    if path is None:
        raise ConfigError(
            "this sensor is not calibrated, so nothing of it can be said in millimetres; make a calibration with "
            "`gelgate lab calibrate --heights`, and name it with --calibration or as `gel.heights`"
        )
    return path


def _picture(path: Path) -> "U8":
    """A picture of the camera's size, or of 320x240 as the maker crops it. Errors: HeightError."""
    from edge.core.errors import HeightError

    try:
        return _decode(path.read_bytes(), str(path))
    except OSError as error:
        raise HeightError(f"{path} cannot be read: {error.strerror}; name a JPEG or PNG") from error


def _decode(payload: bytes, name: str) -> "U8":
    from edge.core.errors import FrameCorrupt, HeightError
    from edge.core.imaging.decode import decode
    from edge.core.imaging.frames import CameraFrame
    from edge.core.imaging.known_profiles import PROFILES

    frame = CameraFrame(payload, 0, 0)
    known = {PROFILES[one].native: PROFILES[one] for one in ("mini_lr", "cropped_lr")}
    if frame.size not in known:
        found = "no picture" if frame.size is None else "{}x{}".format(*frame.size)
        raise HeightError(
            f"{name} is {found}; heights are measured in the camera's 3280x2464, or in the maker's crop of 320x240"
        )
    try:
        return decode(frame, known[frame.size])
    except FrameCorrupt as error:
        raise HeightError(f"{name}: {error}") from error


def _archived(prefix: str, database: Path, archive: Path | None) -> tuple["U8", "U8", str, str, int]:
    """A press of the archive: its picture, its free gel, sensor, id and time. Errors: ArchiveError, HeightError."""
    from edge.core.errors import HeightError
    from edge.core.heights.height_map import free_picture
    from edge.store.press_archive import ArchiveFolder, find_press

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
    return rgb, free_picture(view), then.serial, then.press_id, then.time_ns


def _say(found: "HeightMap") -> None:
    highest = float(found.heights_mm.max())
    u95 = float(found.u95_mm.flat[int(found.heights_mm.argmax())])
    area = float(found.touched.sum()) * found.mm_per_px**2
    typer.echo(
        f"highest {highest:.3f} mm, +- {u95:.3f} mm (95 %); {area:.1f} mm2 touched; "
        f"{found.mm_per_px:.4f} mm per pixel, +- {found.calibration.scale_u95:.0%}"
    )
