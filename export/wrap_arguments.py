"""The arguments and options that `gelgate bundle wrap` alone has, each with its help."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "Comparison",
    "Graph",
    "Licence",
    "MapOutput",
    "Mean",
    "Method",
    "Negate",
    "Scale",
    "ScoreOutput",
    "Sources",
    "Std",
]

Graph = Annotated[
    Path, typer.Argument(metavar="GRAPH", help="An ONNX file: a picture to a score map and a score.")
]
Sources = Annotated[
    list[Path],
    typer.Argument(
        metavar="SOURCE...", help="Nominal presses that the graph was not trained on, as for `fit`."
    ),
]
Licence = Annotated[
    str | None,
    typer.Option(help="Licence of the graph's weights, such as MIT; 'own' for your own.", show_default=False),
]
Method = Annotated[str, typer.Option(help="The method's name in results.")]
Scale = Annotated[
    str,
    typer.Option(
        "--input", help="0..1, 0..255 or imagenet: where the graph does not show what its input is."
    ),
]
Mean = Annotated[str, typer.Option(help="Subtracted from RGB in 0..1, in place of --input.")]
Std = Annotated[str, typer.Option(help="Then RGB is divided by this.")]
MapOutput = Annotated[str, typer.Option(help="The output that is the score map.")]
ScoreOutput = Annotated[str, typer.Option(help="The output that is the score.")]
Negate = Annotated[bool, typer.Option("--negate", help="Lower scores are more anomalous.")]
Comparison = Annotated[
    Path | None, typer.Option("--report", help="Folder for the comparison with the graph, parity.html.")
]
