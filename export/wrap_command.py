"""`gelgate wrap`: a third party's graph becomes a bundle."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from calibration.fitting.options import (
    Alpha,
    NoContact,
    Output,
    Overwrite,
    Part,
    Position,
    Profile,
    RegionText,
    Resize,
    Threads,
    Threshold,
)

__all__ = ["wrap"]


def wrap(
    graph: Annotated[
        Path, typer.Argument(metavar="GRAPH", help="An ONNX file: frames to score_map and score.")
    ],
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...", help="Nominal presses that the graph was not trained on, as for `fit`."
        ),
    ],
    output: Output,
    part: Part = None,
    position: Position = None,
    method: Annotated[str, typer.Option(help="The method's name in results.")] = "external",
    profile: Profile = "",
    region: RegionText = "centre",
    alpha: Alpha = 0.05,
    threshold: Threshold = None,
    no_contact: NoContact = None,
    resize: Resize = False,
    threads: Threads = 2,
    overwrite: Overwrite = False,
) -> None:
    """Make a bundle of another tool's detector graph.

    The threshold comes from nominal presses."""
    from calibration.fitting.command import (
        chosen_profile,
        counted,
        found_sources,
        make,
        nominal_presses,
        refuse_existing,
    )
    from edge.core.errors import ConfigError
    from edge.core.imaging.region import Region
    from export.external_graph import WrapConfig, wrap_files

    refuse_existing(output, overwrite)
    try:
        content = graph.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{graph} cannot be read: {error.strerror}; give the detector's ONNX file"
        ) from error
    sensor = chosen_profile(profile, sources)
    inspected = Region.parse(region, sensor.size)
    found = found_sources(sources, part, position, sensor)
    config = WrapConfig(found.part, found.position, sensor, inspected, method, alpha, threshold, threads)
    presses = nominal_presses(found, sensor, inspected, no_contact, resize)
    typer.echo(f"{counted(len(presses))}, {graph.name} as '{method}', region {inspected}")
    make(partial(wrap_files, content, presses, config), output, overwrite)
