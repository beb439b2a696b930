"""The options that `fit` and `wrap` have in common, each with its help.

What is hidden is written under `--set`; its own option ends with this version.
"""

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "Alpha",
    "AugmentOption",
    "Backbone",
    "ChosenBackbone",
    "ChosenMethod",
    "GelId",
    "HiddenPattern",
    "HiddenProfile",
    "HiddenRegion",
    "HiddenRevision",
    "HiddenSeed",
    "HiddenThreads",
    "HiddenThreshold",
    "Holdout",
    "LeaveOut",
    "Limit",
    "NoContact",
    "Output",
    "Overwrite",
    "Part",
    "Pattern",
    "Position",
    "Profile",
    "RegionText",
    "RegisterOption",
    "Resize",
    "Revision",
    "Scattered",
    "Seed",
    "Settings",
    "Threads",
    "Threshold",
]

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
Profile = Annotated[str, typer.Option(help="Sensor profile; default: the recording's, else mini_lr.")]
HiddenProfile = Annotated[
    str, typer.Option(hidden=True, help="Sensor profile; default: the recording's, else mini_lr.")
]
RegionText = Annotated[str, typer.Option(help="'centre', 'full', or x,y,WIDTHxHEIGHT.")]
HiddenRegion = Annotated[str, typer.Option(hidden=True, help="'centre', 'full', or x,y,WIDTHxHEIGHT.")]
RegisterOption = Annotated[
    str,
    typer.Option(
        hidden=True,
        help="Bring presses to one pose: 'auto' where parts lie apart and it finds more damage, 'never', 'always'.",
    ),
]
GelId = Annotated[
    str | None,
    typer.Option(
        "--gel", help="The gel of the presses, by its id in `gelgate gel show`.", show_default=False
    ),
]
AugmentOption = Annotated[
    str,
    typer.Option(
        hidden=True,
        help="Learn rendered copies of the presses too: 'auto' with at most 8 presses and a picture of the free gel, "
        "'never', 'always'.",
    ),
]
Backbone = Annotated[str, typer.Option(help="An installed backbone, or a trunk .onnx file.")]
ChosenMethod = Annotated[
    str,
    typer.Option(
        "--method",
        help="The detector; 'auto': of padim and patchcore the one that shows most of the damage put into the presses.",
    ),
]
ChosenBackbone = Annotated[
    str,
    typer.Option(
        "--backbone",
        help="'auto': of those that ship the one that shows most of the damage put into the presses; else an "
        "installed backbone, or a trunk .onnx file.",
    ),
]
Alpha = Annotated[float, typer.Option(help="False-alarm rate of the threshold.")]
Threshold = Annotated[float | None, typer.Option(help="Use this threshold instead of finding one.")]
HiddenThreshold = Annotated[
    float | None, typer.Option(hidden=True, help="Use this threshold instead of finding one.")
]
NoContact = Annotated[list[Path] | None, typer.Option(help="Pictures of the free gel, or a folder of them.")]
Resize = Annotated[
    bool,
    typer.Option(help="Cut pictures of any size to the profile's aspect, in the middle, and scale them."),
]
Pattern = Annotated[
    str | None,
    typer.Option(help="Which files of a folder, also in folders below it, such as '*/press.png'."),
]
HiddenPattern = Annotated[
    str | None,
    typer.Option(
        hidden=True, help="Which files of a folder, also in folders below it, such as '*/press.png'."
    ),
]
Holdout = Annotated[
    float,
    typer.Option(
        hidden=True,
        help="Share of a dataset's specimens that is kept for `gelgate evaluate`.",
        min=0,
        max=0.9,
    ),
]
Limit = Annotated[
    str,
    typer.Option(
        hidden=True,
        help="'chosen': the limit that finds most of the damage rendered into the presses; 'plain': one for all "
        "places.",
    ),
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
Scattered = Annotated[
    bool, typer.Option("--scattered", hidden=True, help="Fit any method to parts that lie anywhere.")
]
Seed = Annotated[int, typer.Option(help="Fixes every random choice.")]
HiddenSeed = Annotated[int, typer.Option(hidden=True, help="Fixes every random choice.")]
Threads = Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")]
HiddenThreads = Annotated[int, typer.Option(hidden=True, min=1, max=64, help="Threads of the runtime.")]
Overwrite = Annotated[bool, typer.Option(help="Replace an existing bundle.")]
Revision = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Number of this bundle; by default one more than that of the bundle that it replaces, or 1.",
    ),
]
HiddenRevision = Annotated[
    int | None,
    typer.Option(
        hidden=True,
        min=1,
        help="Number of this bundle; by default one more than that of the bundle that it replaces, or 1.",
    ),
]
