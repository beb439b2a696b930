"""`gelgate lab calibrate --simulator`: a real sensor's presses of a ball in, a sensor's file for the simulator out."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.fitting.options import NoContact, Pattern, Resize

if TYPE_CHECKING:
    from calibration.sensor_fit.calibrate import Calibrated

__all__ = ["calibrate"]


def calibrate(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="PRESSES...", help="Presses of one ball: recordings, folders or pictures."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The sensor's file, a name ending in .toml.")
    ],
    ball_radius_mm: Annotated[float, typer.Option(min=0.2, max=100, help="The ball's radius, in mm.")],
    is_simulator: Annotated[
        bool, typer.Option("--simulator", help="Fit the simulator's colours, gel and noise.")
    ] = False,
    no_contact: NoContact = None,
    mm_per_px: Annotated[
        float | None,
        typer.Option(min=0.005, max=0.5, help="Of a picture of 320x240; default: a GelSight Mini's."),
    ] = None,
    resize: Resize = False,
    pattern: Pattern = None,
    overwrite: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Fit the simulator to a sensor, from presses of a ball.

    Ten to twenty presses, spread over the view, and a picture of the free gel.

    Each press is also simulated by a fit without it; the error inside contact is printed, in grey levels rms, and a
    picture next to the file shows real, simulated and difference. `gelgate lab simulate --sensor FILE` reads the file.
    """
    from calibration.fitting.presses.nominal_presses import read_presses
    from calibration.progress import Stages
    from calibration.sensor_fit.calibrate import calibrate_sensor
    from calibration.simulator.field_of_view import LR
    from edge.core.errors import ConfigError
    from edge.core.imaging.known_profiles import profile
    from edge.core.imaging.region import Region

    if not is_simulator:
        raise ConfigError("nothing to calibrate is named; give --simulator")
    sheet = _check_output(output, overwrite)
    own = profile("mini_lr")
    presses = read_presses(
        sources, own, Region.full(own.size), no_contact=no_contact, resize=resize, pattern=pattern
    )
    with Stages() as report:
        made = calibrate_sensor(
            presses,
            output.stem,
            ball_radius_mm,
            mm_per_px or LR.mm_per_px[0],
            partial(report, "calibrate"),
        )
    _say(made)
    _write(made, output, sheet)
    typer.echo(f"written: {output}, {sheet}")


def _check_output(output: Path, overwrite: bool) -> Path:
    """Return where the picture goes. Errors: ConfigError before any work is done."""
    from edge.core.errors import ConfigError

    if output.suffix != ".toml":
        raise ConfigError(f"a sensor's file ends in .toml, found '{output.name}'")
    sheet = output.with_suffix(".png")
    for path in (output, sheet):
        if path.exists() and not overwrite:
            raise ConfigError(f"{path} exists; name another file, or replace it with --overwrite")
    return sheet


def _say(made: "Calibrated") -> None:
    fitted = made.sensor.fitted
    assert fitted is not None
    for name, reason in made.left_out.items():
        typer.echo(f"left out: {name}: {reason}")
    typer.echo("press, held out: levels rms inside contact, of a change of; outside")
    for one in made.judged:
        typer.echo(f"  {one.name:32} {one.inside:5.1f} of {one.signal:5.1f}; {one.outside:5.1f}")
    typer.echo(
        f"{len(made.judged)} presses held out, {fitted.presses} of them by folds: {fitted.inside_levels:.1f} levels "
        f"rms inside contact, {fitted.outside_levels:.1f} outside"
    )
    for warning in made.warnings:
        typer.echo(f"warning: {warning}")


def _write(made: "Calibrated", output: Path, sheet: Path) -> None:
    import cv2

    from calibration.folders import write_atomically
    from calibration.sensor_fit.result import calibration_sheet

    _, data = cv2.imencode(".png", cv2.cvtColor(calibration_sheet(made.judged), cv2.COLOR_RGB2BGR))
    write_atomically(sheet, data.tobytes())
    write_atomically(output, made.sensor.to_toml().encode())
