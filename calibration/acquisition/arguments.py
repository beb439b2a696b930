"""The options of `gelgate bundle acquire`."""

from dataclasses import dataclass
from pathlib import Path

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
from edge.cli.arguments import add_argument, add_option

__all__ = ["AcquireArguments"]

# A limit on memory: 4 bytes for each pair of presses and each cell, 125 MB on the default region.
MOST_PRESSES = 200


@dataclass(frozen=True)
class AcquireArguments:
    """What the command line says."""

    output: Path = add_option(..., "Folder of the acquisition: new, or one to continue.", "--output", "-o")
    sources: list[Path] | None = add_argument(
        None, "Recordings, datasets or pictures in place of a sensor.", metavar="[SOURCE...]"
    )
    config: Path | None = add_option(
        None, "A station's TOML file: its sensor is read.", "--config", "-c", show_default=False
    )
    device: str | None = add_option(None, "A device plugin, such as gelsight_mini.")
    option: list[str] | None = add_option(None, "A device option, as name=value; repeatable.")
    part: Part = None
    position: Position = None
    method: str = add_option(DEFAULT_METHOD, "The detector that will be fitted; its first tap is compared.")
    backbone: Backbone = DEFAULT_BACKBONE
    profile: Profile = ""
    region: RegionText = "centre"
    no_contact: NoContact = None
    resize: Resize = False
    pattern: Pattern = None
    per_piece: int | None = add_option(None, "A new piece is put in after this number of presses.", min=1)
    enter: bool = add_option(
        False, "A new piece is in place whenever a line is entered (the Enter key).", "--enter"
    )
    promise: float = add_option(0.1, "The rate of false alarms to promise.")
    confidence: float = add_option(0.9, "How sure the promise is.")
    most: int = add_option(100, "Stop at this number of presses.", min=1, max=MOST_PRESSES)
    go_on: bool = add_option(False, "Do not stop when presses are enough, but at --most.", "--go-on")
    fit: Path | None = add_option(None, "Fit this bundle at the end.", show_default=False)
    threads: Threads = 2
