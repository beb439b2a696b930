"""`gelgate export detect` and `gelgate export import`: what a foreign file is, and a bundle of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from calibration.fitting.command import choose_profile, refuse_existing, resolve_sources
from calibration.fitting.options import (
    Alpha,
    NoContact,
    Output,
    Overwrite,
    Part,
    Position,
    Profile,
    Resize,
    Settings,
    Threads,
)
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.progress import Stages
from edge.cli.arguments import add_argument, add_option, flatten, parse_values
from edge.core.errors import ConfigError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from export.importers.api import ImportOptions, import_detector
from export.importers.contract import importer_of
from plugins.reading.isolated import read_foreign

__all__ = ["detect", "import_"]

File = Annotated[Path, typer.Argument(metavar="FILE", help="A file that a research program wrote.")]


@dataclass(frozen=True)
class ImportArguments:
    """What the command line says."""

    output: Output
    file: File
    sources: list[Path] = add_argument(
        ..., "Nominal presses that the model was not trained on, as for `fit`.", metavar="SOURCE..."
    )
    part: Part = None
    position: Position = None
    licence: str | None = add_option(
        None, "The licence of model and weights, such as Apache-2.0, or 'own'.", show_default=False
    )
    backbone: str | None = add_option(
        None, "The trunk, for files without backbone weights: .onnx, or an installed one.", show_default=False
    )
    profile: Profile = ""
    region: str | None = add_option(
        None,
        "'centre', 'full', or x,y,WIDTHxHEIGHT; default: what such a model is trained on.",
        show_default=False,
    )
    rank: int | None = add_option(
        None, "Directions of PaDiM at most; default: all, exact.", min=1, show_default=False
    )
    packing: str = add_option("float16", "How the bank is stored: none, float16 or int8.")
    threshold: str = add_option(
        "presses", "'presses': from the presses; 'model': the model's own; or a number."
    )
    alpha: Alpha = 0.05
    channels: Path | None = add_option(
        None, "PaDiM's channels, where the file lacks them.", show_default=False
    )
    settings: Settings = None
    no_contact: NoContact = None
    resize: Resize = False
    importer: str | None = add_option(None, "The importer, where several know the file.", show_default=False)
    threads: Threads = 2
    overwrite: Overwrite = False


def detect(file: File) -> None:
    """Say what a file of a research program is.

    It is read in a process of its own, without network, and nothing that is in it is run."""
    with read_foreign(file) as foreign:
        importer, what = importer_of(foreign)
        typer.echo(f"{file}: {what.what}; importer {importer.name}")
        for name, value in what.fields.items():
            typer.echo(f"  {name}: {value}")
        typer.echo(f"  {foreign.isolation}")
        needs = "".join(f" {option}" for option in what.needs)
        typer.echo(f"  gelgate export import {file} SOURCE... -o BUNDLE --part NAME --licence NAME{needs}")


@flatten
def import_(given: ImportArguments) -> None:
    """Make a bundle of a detector that a research program trained.

    The threshold comes from nominal presses that the model has not seen, or from the model."""
    refuse_existing(given.output, given.overwrite)
    sensor = choose_profile(given.profile, given.sources)
    sources = resolve_sources(given.sources, given.part, given.position, sensor)
    options = ImportOptions(
        part=sources.part,
        licence=given.licence,
        position=sources.position,
        backbone=given.backbone,
        profile=sensor.name,
        region=given.region,
        rank=given.rank,
        packing=given.packing,  # type: ignore[arg-type]  # ImportOptions checks it
        threshold=_threshold(given.threshold),
        alpha=given.alpha,
        channels=given.channels,
        values=parse_values("--set", given.settings or []),
        importer=given.importer,
        threads=given.threads,
    )

    def read(profile: SensorProfile, inspected: Region) -> NominalPresses:
        return read_presses(
            sources.paths,
            profile,
            inspected,
            no_contact=given.no_contact,
            resize=given.resize,
            specimens=sources.specimens,
        )

    with Stages() as report:
        made = import_detector(
            given.file, read, given.output, options, overwrite=given.overwrite, report=report
        )
    for warning in made.warnings:
        typer.echo(f"warning: {warning}", err=True)
    for line in (made.what.what, *made.model.says, made.losses.words(), made.isolation):
        typer.echo(line)
    typer.echo(f"bundle {options.part}/{options.position} written to {given.output}")


def _threshold(text: str) -> float | Literal["presses", "model"]:
    """Read the option of the threshold. Errors: ConfigError."""
    if text == "presses":
        return "presses"
    if text == "model":
        return "model"
    try:
        return float(text)
    except ValueError as error:
        raise ConfigError(f"--threshold is presses, model or a number, found '{text}'") from error
