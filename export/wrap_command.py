"""`gelgate wrap`: a third party's graph becomes a bundle."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from export.single_graph import GraphInput

__all__ = ["wrap"]


def wrap(
    graph: Annotated[
        Path, typer.Argument(metavar="GRAPH", help="An ONNX file: a picture to a score map and a score.")
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
    licence: Annotated[
        str | None,
        typer.Option(
            help="Licence of the graph's weights, such as MIT; 'own' for your own.", show_default=False
        ),
    ] = None,
    method: Annotated[str, typer.Option(help="The method's name in results.")] = "external",
    scale: Annotated[
        str,
        typer.Option(
            "--input", help="0..1, 0..255 or imagenet: where the graph does not show what its input is."
        ),
    ] = "",
    mean: Annotated[str, typer.Option(help="Subtracted from RGB in 0..1, in place of --input.")] = "",
    std: Annotated[str, typer.Option(help="Then RGB is divided by this.")] = "",
    map_output: Annotated[str, typer.Option(help="The output that is the score map.")] = "",
    score_output: Annotated[str, typer.Option(help="The output that is the score.")] = "",
    negate: Annotated[bool, typer.Option("--negate", help="Lower scores are more anomalous.")] = False,
    comparison: Annotated[
        Path | None, typer.Option("--report", help="Folder for the comparison with the graph, parity.html.")
    ] = None,
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

    The graph is adapted and compared with itself. The threshold comes from nominal presses."""
    from calibration.fitting.command import (
        chosen_profile,
        counted,
        found_sources,
        make,
        nominal_presses,
        refuse_existing,
    )
    from edge.core.imaging.region import Region
    from export.external_graph import WrapConfig, wrap_files
    from export.licence import stated_licence
    from export.single_graph import GraphInput

    refuse_existing(output, overwrite)
    content = _read(graph)
    stated = stated_licence(licence, f"the graph {graph}")
    sensor = chosen_profile(profile, sources)
    inspected = Region.parse(region, sensor.size)
    found = found_sources(sources, part, position, sensor)
    presses = nominal_presses(found, sensor, inspected, no_contact, resize)
    given = GraphInput(
        scale or None,
        _colours("--mean", mean),
        _colours("--std", std),
        map_output or None,
        score_output or None,
        negate,
    )
    ready, facts = _adapted(graph, content, presses.frames, given, comparison)
    config = WrapConfig(
        found.part,
        found.position,
        sensor,
        inspected,
        method,
        alpha,
        threshold,
        threads,
        {"licence": stated, "graph": graph.name, **facts},
    )
    typer.echo(f"{counted(len(presses))}, {graph.name} as '{method}', region {inspected}")
    make(partial(wrap_files, ready, presses, config), output, overwrite)


def _read(graph: Path) -> bytes:
    from edge.core.errors import ConfigError

    try:
        return graph.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{graph} cannot be read: {error.strerror}; give the detector's ONNX file"
        ) from error


def _colours(option: str, text: str) -> tuple[float, float, float] | None:
    from export.backbone_command import three_numbers

    return three_numbers(option, text) if text else None


def _adapted(
    graph: Path, content: bytes, frames: "NDArray[np.uint8]", given: "GraphInput", report: Path | None
) -> tuple[bytes, dict[str, str]]:
    """The graph as the gateway runs it, and what was found of it. Errors: as `adapted`; BundleCorrupt."""
    from edge.extras import is_installed, needs
    from export.single_graph import GraphInput, adapted

    if not is_installed("onnx") and given == GraphInput() and report is None:
        return (
            content,
            {},
        )  # a graph that meets the contract needs no change; others are refused when they are opened
    needs("export", "wrap")
    ready = adapted(content, frames, given, graph.name)
    if ready.parity is not None:
        if report is not None:
            ready.parity.write(report)
        ready.parity.raise_if_different()
        for name, words in ready.found.items():
            typer.echo(f"{name}: {words}")
    return ready.graph, ready.found
