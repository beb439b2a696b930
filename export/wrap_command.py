"""`gelgate bundle wrap`: a third party's graph becomes a bundle."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

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
from export.wrap_arguments import (
    Comparison,
    Graph,
    Licence,
    MapOutput,
    Mean,
    Method,
    Negate,
    Scale,
    ScoreOutput,
    Sources,
    Std,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from export.single_graph import GraphInput

__all__ = ["wrap"]


def wrap(
    graph: Graph,
    sources: Sources,
    output: Output,
    part: Part = None,
    position: Position = None,
    licence: Licence = None,
    method: Method = "external",
    scale: Scale = "",
    mean: Mean = "",
    std: Std = "",
    map_output: MapOutput = "",
    score_output: ScoreOutput = "",
    negate: Negate = False,
    comparison: Comparison = None,
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
    from export.graph_file import read_graph
    from export.licence import stated_licence

    refuse_existing(output, overwrite)
    content = read_graph(graph)
    stated = stated_licence(licence, f"the graph {graph}")
    sensor = chosen_profile(profile, sources)
    inspected = Region.parse(region, sensor.size)
    material = found_sources(sources, part, position, sensor)
    presses = nominal_presses(material, sensor, inspected, no_contact, resize)
    given = _graph_input(scale, mean, std, map_output, score_output, negate)
    ready, facts = _adapt(graph, content, presses.frames, given, comparison)
    facts = {"licence": stated, "graph": graph.name, **facts}
    where = (material.part, material.position, sensor, inspected)
    config = WrapConfig(*where, method, alpha, threshold, threads, facts)
    typer.echo(f"{counted(len(presses))}, {graph.name} as '{method}', region {inspected}")
    make(partial(wrap_files, ready, presses, config), output, overwrite)


def _graph_input(
    scale: str, mean: str, std: str, map_output: str, score_output: str, is_negated: bool
) -> "GraphInput":
    from export.single_graph import GraphInput

    colours = _colours("--mean", mean), _colours("--std", std)
    return GraphInput(scale or None, *colours, map_output or None, score_output or None, is_negated)


def _colours(option: str, text: str) -> tuple[float, float, float] | None:
    from export.backbone_command import three_numbers

    return three_numbers(option, text) if text else None


def _adapt(
    graph: Path, content: bytes, frames: "NDArray[np.uint8]", given: "GraphInput", report: Path | None
) -> tuple[bytes, dict[str, str]]:
    """The graph as the gateway runs it, and what was found of it. Errors: as `adapt`; BundleCorrupt."""
    from edge.extras import is_installed
    from export.single_graph import GraphInput, adapt

    if not is_installed("onnx") and given == GraphInput() and report is None:
        return (
            content,
            {},
        )  # a graph that meets the contract needs no change; others are refused when they are opened
    ready = adapt(content, frames, given, graph.name)
    if ready.parity is not None:
        if report is not None:
            ready.parity.write(report)
        ready.parity.raise_if_different()
        for name, words in ready.found.items():
            typer.echo(f"{name}: {words}")
    return ready.graph, ready.found
