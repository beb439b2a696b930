"""`gelgate bundle acquire`: nominal presses one by one, until they are enough."""

import math
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import typer

from calibration.acquisition.acquiring import Acquiring
from calibration.acquisition.arguments import AcquireArguments
from calibration.acquisition.coverage import ROUND, Standing
from calibration.acquisition.report import forecast_lines, press_line, signals, summary_lines
from calibration.acquisition.sources import Found, find_sensor, frames_of, from_frames, from_sources
from calibration.fitting.command import choose_profile, fit, refuse_existing, resolve_sources
from calibration.fitting.presses.recorded_presses import PressFinder
from calibration.fitting.presses.sources import DEFAULT_POSITION, check_name
from edge.cli.arguments import flatten
from edge.clock import SystemClock
from edge.core.errors import ConfigError, FitError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["acquire", "alpha", "check_promise", "fit_now", "summarise", "take_presses"]


@flatten
def acquire(given: AcquireArguments) -> None:
    """Take nominal presses until they are enough, then fit.

    After each press: what is new on it, and what its number promises. Every press is kept at once; after Ctrl-C the
    same command continues.
    """
    if given.fit is not None:
        refuse_existing(given.fit, overwrite=False)
    acquiring, plan, limit = take_presses(given)
    summarise(acquiring, limit)
    if plan.fit is None:
        typer.echo(f"fit them with:\n  {fit_command(acquiring.folder.root, plan, acquiring.standing)}")
    else:
        fit_now(acquiring.folder.root, plan, acquiring.standing, plan.fit)


def take_presses(given: AcquireArguments) -> tuple[Acquiring, AcquireArguments, int]:
    """Take presses until they are enough or Ctrl-C; return them, what they are of, and how many the gel is rated for.

    Errors: as the sources'.
    """
    if sum(bool(source) for source in (given.sources, given.config, given.device)) != 1:
        raise ConfigError("name one of SOURCE, --config and --device; `gelgate devices` lists the devices")
    for name, value in (("--promise", given.promise), ("--confidence", given.confidence)):
        check_promise(name, value)
    if given.per_piece is not None and given.enter:
        raise ConfigError("--per-piece and --enter are two ways to say when a piece is new; give one of them")
    sensor = choose_profile(given.profile, given.sources or [])
    stream, part, position, limit = _stream(given, sensor)
    plan = replace(given, part=part, position=position, profile=sensor.name)
    acquiring = Acquiring(plan, sensor)
    if acquiring.folder.presses:
        typer.echo(f"{plan.output} has {len(acquiring.folder.presses)} presses already; they count")
    try:
        _run(acquiring, stream, limit, given.most, given.go_on)
    except KeyboardInterrupt:
        typer.echo("stopped with Ctrl-C", err=True)
    finally:
        acquiring.folder.close()
    return acquiring, plan, limit


def check_promise(name: str, value: float) -> None:
    """Check a share that is an option of this name. Errors: ConfigError."""
    if not 0 < value < 1:
        raise ConfigError(f"{name} lies between 0 and 1, found {value}; 0.1 is one in ten")


Stream = Iterator[Found]


def _stream(given: AcquireArguments, profile: SensorProfile) -> tuple[Stream, str, str, int]:
    """The presses, their part and position, and how many presses the gel is rated for. Errors: as the sources'."""
    if given.sources:
        sources = resolve_sources(given.sources, given.part, given.position, profile)
        stream = from_sources(
            sources.paths,
            profile,
            sources.specimens,
            no_contact=given.no_contact or (),
            resize=given.resize,
            pattern=given.pattern,
        )
        return stream, sources.part, sources.position, DEFAULT_LIMIT_PRESSES
    if given.part is None:
        raise typer.BadParameter("Missing option '--part': a sensor does not know what is pressed.")
    check_name("--part", given.part)
    check_name("--position", position := given.position or DEFAULT_POSITION)
    clock = SystemClock()
    sensor = find_sensor(given.config, given.device or "", given.option or (), profile, clock)
    frames = frames_of(sensor, clock, lambda text: typer.echo(text, err=True))
    finder = PressFinder(profile, sensor.contact)
    stream = from_frames(
        ((frame, None) for frame in frames), finder, profile, given.device or str(given.config)
    )
    return stream, given.part, position, sensor.gel_limit


def _run(acquiring: Acquiring, stream: Stream, limit: int, most: int, go_on: bool) -> None:
    """Take presses until they are enough, the source ends, or there are `most`."""
    standing = acquiring.standing
    warning_count = 0
    while standing.presses < most and (go_on or not standing.is_enough):
        picture = next(stream, None)
        if picture is None:
            return
        kept = acquiring.take(picture)
        for why in acquiring.left_out[warning_count:]:
            typer.echo(f"warning: left out: {why}", err=True)
        warning_count = len(acquiring.left_out)
        if kept is None or isinstance(picture, str):
            continue
        standing = acquiring.standing
        acquiring.folder.log(signals(standing, kept.path.name, picture.name, picture.piece))
        typer.echo(press_line(standing, kept.piece))
        if standing.presses % ROUND == 0:
            typer.echo("\n".join(forecast_lines(standing, limit)))
        if acquiring.pieces.is_waiting and not standing.is_enough:
            typer.echo(f"put in piece {acquiring.pieces.next}")


def summarise(acquiring: Acquiring, limit: int) -> None:
    """Print the summary and draw the map. Errors: FitError where no press was taken."""
    standing = acquiring.standing
    if not standing.presses:
        why = f": {acquiring.left_out[0]}" if acquiring.left_out else ""
        raise FitError(f"no press was taken{why}; give a source with presses, or press the part onto the gel")
    typer.echo("\n".join(summary_lines(standing, limit)))
    if (picture := acquiring.map()) is not None:
        typer.echo(f"where something is still new: {picture}")


USUAL_ALPHA = 0.05


def alpha(standing: Standing) -> float:
    """The rate to ask `fit` for, so that no nominal press lies above its threshold: the promise counts on that.

    1 / (pieces + 1), rounded up, is the largest rate that puts the threshold at the highest score.
    """
    pieces = standing.presses if standing.pieces is None else standing.pieces
    return min(USUAL_ALPHA, math.ceil(1e4 / (pieces + 1)) / 1e4)


# What the fit is told in the words of the acquisition.
_PASSED_ON = ("part", "position", "profile", "region", "method", "backbone")


def fit_command(folder: Path, plan: AcquireArguments, standing: Standing) -> str:
    """Return the command line that fits the acquired presses."""
    words = ["gelgate", "fit", str(folder), "-o", f"{plan.part}.bundle"]
    for name in _PASSED_ON:
        words += [f"--{name}", str(getattr(plan, name))]
    words += ["--alpha", f"{alpha(standing):g}"] + ["--resize"] * plan.resize
    return shlex.join(words)


def fit_now(folder: Path, plan: AcquireArguments, standing: Standing, output: Path) -> None:
    """Fit the acquired presses and print the summary. Errors: as `gelgate fit`."""
    fit(
        sources=[folder],
        output=output,
        alpha=alpha(standing),
        **{name: getattr(plan, name) for name in (*_PASSED_ON, "resize", "threads")},
    )
