"""The options of `gelgate bundle acquire`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from calibration.fitting.options import (
    DEFAULT_METHOD,
    Backbone,
    NoContact,
    Part,
    Pattern,
    Position,
    Profile,
    RegionText,
    Resize,
    Threads,
)
from calibration.fitting.trunks import DEFAULT_BACKBONE

__all__ = ["AcquireArguments"]

# A limit on memory: 4 bytes for each pair of presses and each cell, 125 MB on the default region.
MOST_PRESSES = 200


@dataclass(frozen=True)
class AcquireArguments:
    """What the command line says."""

    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of the acquisition: new, or one to continue.")
    ]
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SOURCE...]", help="Recordings, datasets or pictures in place of a sensor."),
    ] = None
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="A station's TOML file: its sensor is read.", show_default=False),
    ] = None
    device: Annotated[
        str | None, typer.Option("--device", help="A device plugin, such as gelsight_mini.")
    ] = None
    option: Annotated[
        list[str] | None, typer.Option("--option", help="A device option, as name=value; repeatable.")
    ] = None
    part: Part = None
    position: Position = None
    method: Annotated[
        str, typer.Option(help="The detector that will be fitted; its first tap is compared.")
    ] = DEFAULT_METHOD
    backbone: Backbone = DEFAULT_BACKBONE
    profile: Profile = ""
    region: RegionText = "centre"
    no_contact: NoContact = None
    resize: Resize = False
    pattern: Pattern = None
    per_piece: Annotated[
        int | None,
        typer.Option("--per-piece", min=1, help="A new piece is put in after this number of presses."),
    ] = None
    enter: Annotated[
        bool,
        typer.Option("--enter", help="A new piece is in place whenever a line is entered (the Enter key)."),
    ] = False
    promise: Annotated[float, typer.Option("--promise", help="The rate of false alarms to promise.")] = 0.1
    confidence: Annotated[float, typer.Option(help="How sure the promise is.")] = 0.9
    most: Annotated[
        int, typer.Option("--most", min=1, max=MOST_PRESSES, help="Stop at this number of presses.")
    ] = 100
    go_on: Annotated[
        bool, typer.Option("--go-on", help="Do not stop when presses are enough, but at --most.")
    ] = False
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Fit this bundle at the end.", show_default=False)
    ] = None
    threads: Threads = 2
