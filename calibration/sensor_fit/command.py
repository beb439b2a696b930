"""`gelgate lab calibrate`: presses of a ball in; out a file of heights for a station, or a sensor for the simulator."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Final

import typer

from calibration.fitting.options import NoContact, Pattern, Resize
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.folders import write_atomically
from calibration.progress import Stages
from calibration.sensor_fit.calibrate import Calibrated, calibrate_sensor
from calibration.sensor_fit.heights import CalibratedHeights, calibrate_heights
from calibration.sensor_fit.result import calibration_sheet
from calibration.simulator.field_of_view import LR
from edge.core.detector import Progress
from edge.core.errors import ConfigError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.heights.files import write_calibration
from edge.pictures.image_file import encode

__all__ = ["calibrate"]

# As `SensorFile` has it, before minutes of work.
_SENSOR_NAME: Final = re.compile(r"[A-Za-z0-9_-]{1,60}")


def calibrate(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="PRESSES...", help="Presses of one ball: recordings, folders or pictures."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file, a name ending in .toml.")],
    ball_radius_mm: Annotated[float, typer.Option(min=0.2, max=100, help="The ball's radius, in mm.")],
    is_heights: Annotated[
        bool, typer.Option("--heights", help="Calibrate heights of presses on this gel, in mm.")
    ] = False,
    is_simulator: Annotated[
        bool, typer.Option("--simulator", help="Fit the simulator's colours, gel and noise.")
    ] = False,
    serial: Annotated[
        str | None, typer.Option(help="The sensor's serial; presses of another are then refused.")
    ] = None,
    no_contact: NoContact = None,
    mm_per_px: Annotated[
        float | None,
        typer.Option(min=0.005, max=0.5, help="Of a picture of 320x240; default: a GelSight Mini's."),
    ] = None,
    resize: Resize = False,
    pattern: Pattern = None,
    overwrite: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Calibrate a sensor with its gel, from presses of a ball.

    Ten to twenty presses, spread over the view, and a picture of the free gel.

    Heights: each ball is also measured by a calibration without it; the errors are printed, and become the uncertainty
    of the file. `gelgate station heights` reads it, and `gel.heights` of a station.

    Simulator: each press is also simulated by a fit without it; the error inside contact is printed, in grey levels
    rms, and a picture next to the file shows real, simulated and difference. `gelgate lab simulate --sensor FILE`
    reads the file.
    """
    if is_heights == is_simulator:
        raise ConfigError("nothing to calibrate is named, or both; give --heights or --simulator")
    sheet = output.with_suffix(".png") if is_simulator else None
    _check_output(output, sheet, overwrite)
    own = profile("mini_lr")
    presses = read_presses(
        sources, own, Region.full(own.size), no_contact=no_contact, resize=resize, pattern=pattern
    )
    with Stages() as report:
        say = partial(report, "calibrate")
        if sheet is None:
            _heights(presses, output, ball_radius_mm, mm_per_px, serial, say)
        else:
            _simulator(presses, output, sheet, ball_radius_mm, mm_per_px, say)


def _heights(
    presses: NominalPresses,
    output: Path,
    ball_radius_mm: float,
    mm_per_px: float | None,
    serial: str | None,
    say: Progress,
) -> None:
    made = calibrate_heights(presses, output.stem, ball_radius_mm, mm_per_px, serial, say)
    _say_heights(made, ball_radius_mm)
    dated = replace(made.calibration, made_on=datetime.now(UTC).date())
    write_atomically(output, write_calibration(dated).encode())
    typer.echo(f"written: {output}")


def _say_heights(made: CalibratedHeights, ball_radius_mm: float) -> None:
    for name, reason in made.left_out.items():
        typer.echo(f"left out: {name}: {reason}")
    typer.echo("ball, held out: at x, y mm; radius found; depth, found; free gel within, mm")
    for ball in made.held:
        typer.echo(
            f"  {ball.name:32} {ball.x_mm:+5.1f} {ball.y_mm:+5.1f}; {ball.radius_mm:5.2f}; {ball.depth_mm:.3f} "
            f"{ball.height_mm:.3f}; {ball.outside_mm:.3f}"
        )
    calibration = made.calibration
    typer.echo(
        f"{len(made.held)} balls of {ball_radius_mm:g} mm held out; 95 % of all heights are within "
        f"{calibration.floor_u95_mm:.3f} mm + {calibration.height_u95:.0%}; the scale, "
        f"{calibration.mm_per_px:.4f} mm per pixel, is taken to be right within {calibration.scale_u95:.0%}"
    )


def _simulator(
    presses: NominalPresses,
    output: Path,
    sheet: Path,
    ball_radius_mm: float,
    mm_per_px: float | None,
    say: Progress,
) -> None:
    made = calibrate_sensor(presses, output.stem, ball_radius_mm, mm_per_px or LR.mm_per_px[0], say)
    _say(made)
    write_atomically(sheet, encode(calibration_sheet(made.judged)))
    write_atomically(output, made.sensor.to_toml().encode())
    typer.echo(f"written: {output}, {sheet}")


def _check_output(output: Path, sheet: Path | None, overwrite: bool) -> None:
    """Errors: ConfigError before any work is done."""
    if output.suffix != ".toml":
        raise ConfigError(f"a sensor's file ends in .toml, found '{output.name}'")
    if sheet is not None and not _SENSOR_NAME.fullmatch(output.stem):
        raise ConfigError(
            f"the file's name is that of the sensor: up to 60 letters, digits, '-' and '_', found '{output.stem}'"
        )
    for path in (output, sheet):
        if path is not None and path.exists() and not overwrite:
            raise ConfigError(f"{path} exists; name another file, or replace it with --overwrite")


def _say(made: Calibrated) -> None:
    fitted = made.sensor.fitted
    assert fitted is not None
    for name, reason in made.left_out.items():
        typer.echo(f"left out: {name}: {reason}")
    typer.echo("press, held out: levels rms inside contact, of a change of; outside")
    for press in made.judged:
        typer.echo(f"  {press.name:32} {press.inside:5.1f} of {press.signal:5.1f}; {press.outside:5.1f}")
    typer.echo(
        f"{len(made.judged)} presses held out, {fitted.presses} of them by folds: {fitted.inside_levels:.1f} levels "
        f"rms inside contact, {fitted.outside_levels:.1f} outside"
    )
    for warning in made.warnings:
        typer.echo(f"warning: {warning}")
