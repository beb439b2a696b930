"""The options that verbs of nominal presses have in common, each with its help."""

import copy
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.models import OptionInfo

__all__ = [
    "DEFAULT_METHOD",
    "Alpha",
    "Backbone",
    "GelId",
    "LeaveOut",
    "NoContact",
    "Output",
    "Overwrite",
    "Part",
    "Pattern",
    "Position",
    "Profile",
    "RegionText",
    "Resize",
    "Revision",
    "Seed",
    "Settings",
    "Threads",
    "Threshold",
    "under_set",
]

DEFAULT_METHOD = "padim"

Output = Annotated[
    Path, typer.Option("--output", "-o", help="The bundle: a folder, or a name ending in .zip.")
]
Part = Annotated[
    str | None,
    typer.Option(help="Which part is pressed; optional for a dataset of one part.", show_default=False),
]
Position = Annotated[
    str | None,
    typer.Option(
        help="Where on the part; default: the dataset's only one, else 'default'.", show_default=False
    ),
]
Profile = Annotated[
    str, typer.Option(help="Sensor profile; default: the recording's, or that of its size, else mini_lr.")
]
RegionText = Annotated[str, typer.Option(help="'centre', 'full', or x,y,WIDTHxHEIGHT.")]
GelId = Annotated[
    str | None,
    typer.Option(
        "--gel", help="The gel of the presses, by its id in `gelgate gel show`.", show_default=False
    ),
]
Backbone = Annotated[str, typer.Option(help="An installed backbone, or a trunk .onnx file.")]
Alpha = Annotated[float, typer.Option(help="False-alarm rate of the threshold.")]
Threshold = Annotated[float | None, typer.Option(help="Use this threshold instead of finding one.")]
NoContact = Annotated[list[Path] | None, typer.Option(help="Pictures of the free gel, or a folder of them.")]
Resize = Annotated[
    bool,
    typer.Option(help="Cut pictures of any size to the profile's aspect, in the middle, and scale them."),
]
Pattern = Annotated[
    str | None,
    typer.Option(help="Which files of a folder, also in folders below it, such as '*/press.png'."),
]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="A press to leave out, by its name in a warning."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A parameter of the fit or of the detector; `gelgate station docs parameters` lists them.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Fixes every random choice.")]
Threads = Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")]
Overwrite = Annotated[bool, typer.Option(help="Replace an existing bundle.")]
Revision = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Number of this bundle; by default one more than that of the bundle that it replaces, or 1.",
    ),
]


def under_set(option: Any) -> OptionInfo:
    """Return the option of an annotated type as one that help does not show: it is written under `--set`.

    Its own option ends with this version.
    """
    (shown,) = option.__metadata__
    hidden: OptionInfo = copy.copy(shown)
    hidden.hidden = True
    return hidden
