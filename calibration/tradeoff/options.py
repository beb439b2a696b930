"""The options of `tradeoff`, each with its help."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "Backbones",
    "Bootstrap",
    "BundlePath",
    "Check",
    "DatasetFolder",
    "Methods",
    "Minutes",
    "Output",
    "Overwrite",
    "Part",
    "Peers",
    "Picture",
    "Point",
    "Position",
    "Presses",
    "Rounds",
    "Seed",
    "Threads",
    "Under",
    "Within",
]

DatasetFolder = Annotated[
    Path, typer.Argument(help="the folder of presses, good ones and defective ones with masks")
]
Output = Annotated[Path, typer.Option("--output", "-o", help="the folder for rows.jsonl and tradeoff.html")]
Part = Annotated[str | None, typer.Option(help="the part; optional for a dataset of one part")]
Position = Annotated[str | None, typer.Option(help="the position; optional for one position")]
Methods = Annotated[
    list[str] | None, typer.Option(help="a detector, again for more; by default every installed one")
]
Backbones = Annotated[
    list[str] | None,
    typer.Option(
        help="an installed backbone or a trunk .onnx file, the first varied in every axis, again for more"
    ),
]
Within = Annotated[str | None, typer.Option(help="choose a point: most time of a press, such as 20ms")]
Under = Annotated[str | None, typer.Option(help="choose a point: largest bank, such as 8MB")]
Presses = Annotated[int | None, typer.Option(help="choose a point: most nominal presses", min=1)]
Point = Annotated[str | None, typer.Option(help="make only the bundle of the point of this name")]
BundlePath = Annotated[
    Path | None,
    typer.Option(help="where the chosen bundle is written, a folder or a name ending in .zip"),
]
Check = Annotated[
    Path | None, typer.Option(help="rows.jsonl of an earlier run: fail where this one is worse")
]
Picture = Annotated[Path | None, typer.Option(help="also draw the rows as an SVG file of this name")]
Peers = Annotated[bool, typer.Option("--peers", help="also measure anomalib's PaDiM and PatchCore")]
Rounds = Annotated[int, typer.Option(help="rounds of timing", min=7)]
Minutes = Annotated[float, typer.Option(help="after this many no new round of timing begins", min=0)]
Bootstrap = Annotated[int, typer.Option(help="bootstrap replicates per accuracy interval", min=20)]
Seed = Annotated[int, typer.Option(help="fixes every random choice", min=0)]
Threads = Annotated[int, typer.Option(help="threads of the runtime", min=1, max=64)]
Overwrite = Annotated[
    bool, typer.Option(help="measure again although the folder has rows; replace the bundle")
]
