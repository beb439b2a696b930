"""`gelgate wrap`: a third party's graph in, a bundle out."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["wrap"]


def wrap(
    graph: Annotated[
        Path, typer.Argument(metavar="GRAPH", help="An ONNX file: frames to score_map and score.")
    ],
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SOURCE...", help="Nominal presses that it was not trained on, as for `fit`."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The bundle: a folder, or a name ending in .zip.")
    ],
    part: Annotated[str, typer.Option(help="Which part is pressed.")],
    position: Annotated[str, typer.Option(help="Where on the part.")] = "default",
    method: Annotated[str, typer.Option(help="The name that results carry.")] = "external",
    profile: Annotated[
        str, typer.Option(help="Sensor profile; default: what the recording names, else mini_lr.")
    ] = "",
    region: Annotated[str, typer.Option(help="'centre', 'full', or x,y,WIDTHxHEIGHT.")] = "centre",
    alpha: Annotated[float, typer.Option(help="False-alarm rate that the threshold is set for.")] = 0.05,
    threshold: Annotated[
        float | None, typer.Option(help="Use this threshold instead of finding one.")
    ] = None,
    no_contact: Annotated[
        list[Path] | None, typer.Option(help="Pictures of the free gel, or a folder of them.")
    ] = None,
    resize: Annotated[bool, typer.Option(help="Scale pictures of any size to the profile's.")] = False,
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")] = 2,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing bundle.")] = False,
) -> None:
    """Make a bundle of someone else's detector; the threshold comes from nominal presses."""
    import datetime

    from calibration.fitting.command import chosen_profile, counted, refuse_existing, summary, write
    from calibration.fitting.nominal_presses import read_presses
    from calibration.progress import Stages
    from edge.core.errors import ConfigError
    from edge.core.imaging.region import Region
    from export.external_graph import WrapRecipe, wrap_files

    refuse_existing(output, overwrite)
    try:
        content = graph.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{graph} cannot be read: {error.strerror}; give the detector's ONNX file"
        ) from error
    sensor = chosen_profile(profile, sources)
    inspected = Region.parse(region, sensor.size)
    recipe = WrapRecipe(part, position, sensor, inspected, method, alpha, threshold, threads)
    presses = read_presses(sources, sensor, inspected, no_contact=no_contact or (), resize=resize)
    typer.echo(f"{counted(len(presses))}, {graph.name} as '{method}', region {inspected}")
    with Stages() as report:
        fitted = wrap_files(
            content, presses, recipe, created=datetime.date.today().isoformat(), report=report
        )
    write(fitted, output, overwrite)
    summary(fitted, output)
