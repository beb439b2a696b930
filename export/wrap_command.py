"""`gelgate bundle wrap`: a third party's graph becomes a bundle."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import typer

from calibration.fitting.command import choose_profile, make, refuse_existing, resolve_sources
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
from calibration.fitting.presses.nominal_presses import read_presses
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.arrays import U8
from edge.core.imaging.region import Region
from edge.core.printable import write_count
from export.backbone_command import three_numbers
from export.finish import WrapConfig, wrap_files
from export.graph_file import read_graph
from export.known_weights import stated_licence
from export.single_graph import GraphInput, adapt

__all__ = ["wrap"]


@dataclass(frozen=True)
class WrapArguments:
    """What the command line says."""

    output: Output
    graph: Path = add_argument(..., "An ONNX file: a picture to a score map and a score.", metavar="GRAPH")
    sources: list[Path] = add_argument(
        ..., "Nominal presses that the graph was not trained on, as for `fit`.", metavar="SOURCE..."
    )
    part: Part = None
    position: Position = None
    licence: str | None = add_option(
        None, "Licence of the graph's weights, such as MIT; 'own' for your own.", show_default=False
    )
    method: str = add_option("external", "The method's name in results.")
    scale: str = add_option(
        "", "0..1, 0..255 or imagenet: where the graph does not show what its input is.", "--input"
    )
    mean: str = add_option("", "Subtracted from RGB in 0..1, in place of --input.")
    std: str = add_option("", "Then RGB is divided by this.")
    map_output: str = add_option("", "The output that is the score map.")
    score_output: str = add_option("", "The output that is the score.")
    negate: bool = add_option(False, "Lower scores are more anomalous.", "--negate")
    comparison: Path | None = add_option(
        None, "Folder for the comparison with the graph, parity.html.", "--report"
    )
    profile: Profile = ""
    region: RegionText = "centre"
    alpha: Alpha = 0.05
    threshold: Threshold = None
    no_contact: NoContact = None
    resize: Resize = False
    threads: Threads = 2
    overwrite: Overwrite = False


@flatten
def wrap(given: WrapArguments) -> None:
    """Make a bundle of another tool's detector graph.

    The graph is adapted and compared with itself. The threshold comes from nominal presses."""
    graph = given.graph
    refuse_existing(given.output, given.overwrite)
    content = read_graph(graph)
    licence = stated_licence(given.licence, f"the graph {graph}")
    sensor = choose_profile(given.profile, given.sources)
    region = Region.parse(given.region, sensor.size)
    material = resolve_sources(given.sources, given.part, given.position, sensor)
    presses = read_presses(
        material.paths,
        sensor,
        region,
        no_contact=given.no_contact,
        resize=given.resize,
        specimens=material.specimens,
    )
    ready, facts = _adapt(given, content, presses.frames)
    facts = {"licence": licence, "graph": graph.name, **facts}
    where = (material.part, material.position, sensor, region)
    config = WrapConfig(*where, given.method, given.alpha, given.threshold, given.threads, facts)
    typer.echo(
        f"{write_count(len(presses), 'nominal press')}, {graph.name} as '{given.method}', region {region}"
    )
    make(partial(wrap_files, ready, presses, config), given.output, given.overwrite)


def _adapt(given: WrapArguments, content: bytes, frames: U8) -> tuple[bytes, dict[str, str]]:
    """The graph as the gateway runs it, and what was found of it. Errors: as `adapt`; BundleCorrupt."""
    mean, std = (
        three_numbers(option, text) if text else None
        for option, text in (("--mean", given.mean), ("--std", given.std))
    )
    wanted = GraphInput(
        given.scale or None, mean, std, given.map_output or None, given.score_output or None, given.negate
    )
    ready = adapt(content, frames, wanted, given.graph.name)
    if ready.parity is not None:
        if given.comparison is not None:
            ready.parity.write(given.comparison)
        ready.parity.raise_if_different()
        for name, words in ready.found.items():
            typer.echo(f"{name}: {words}")
    return ready.graph, ready.found
