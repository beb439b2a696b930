"""The verb `evaluate-backbone`."""

import json
import os
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import typer

from calibration.experiments.backbones.evaluation import RANDOM, evaluate, evaluation_tables, random_trunk
from calibration.experiments.backbones.sets import SETS, EvaluationSet, evaluation_sets
from calibration.experiments.harness.study import methods_to_compare, require_known
from calibration.fitting.trunks import open_trunk
from calibration.folders import make_folder, write_atomically
from calibration.progress import progress
from edge import registry
from edge.core.errors import ConfigError
from plugins.backbones.tactile import tactile_resnet18

__all__ = ["evaluate_backbone"]

_SHIPPED = ["trained=tactile_resnet18", "trained_int8=tactile_resnet18_int8"]
_TRUNKS_HELP = (
    "an installed backbone or a trunk .onnx file under the name of its rows, the one that ships first; "
    f"default: {' '.join(_SHIPPED)}"
)


def evaluate_backbone(
    out: Annotated[Path, typer.Argument(help="output folder of the evaluation file")],
    trunks: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME=TRUNK]...", help=_TRUNKS_HELP),
    ] = None,
    random: Annotated[bool, typer.Option(help="compare with random weights, under the name random")] = True,
    only: Annotated[
        list[str] | None,
        typer.Option("--set", help="only this set of trials, for every trunk; may be given several times"),
    ] = None,
    methods: Annotated[
        list[str] | None,
        typer.Option("--method", help="a detector to compare with; default: all but the baselines"),
    ] = None,
    trials: Annotated[int, typer.Option(help="at most this many trials of each set, 0 for all", min=0)] = 0,
    replicates: Annotated[int, typer.Option(help="bootstrap replicates per interval", min=0)] = 200,
    workers: Annotated[int, typer.Option(help="trials in parallel", min=1, max=64)] = 1,
) -> None:
    """Compare backbones on presses that training never draws. docs/backbone.md has the results."""
    # Workers are separate processes; several linear algebra threads in each would compete for the cores.
    if workers > 1:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    sets = _choose_sets(only or [], trials)
    graphs = _graphs(trunks or _SHIPPED, random)
    detectors = methods or methods_to_compare()
    for method in detectors:
        registry.detector(method)  # one that is not known is refused before the folder is made
    make_folder(out)
    with progress("trials", sum(len(chosen.trials) for chosen in sets.values())) as advance:
        evaluation = evaluate(
            graphs, sets, detectors, replicates=replicates, workers=workers, advance=advance
        )
    evaluation["trunks"] = {
        name: {"sha256": sha256(graph).hexdigest(), "bytes": len(graph)} for name, graph in graphs.items()
    }
    file = out / f"{tactile_resnet18.name}_evaluation.json"
    write_atomically(file, (json.dumps(evaluation, indent=1) + "\n").encode())
    typer.echo(evaluation_tables(evaluation))


def _choose_sets(only: list[str], trials: int) -> dict[str, EvaluationSet]:
    """Choose the sets to compare on; a set that is named is run for every trunk. Errors: ConfigError."""
    require_known("set of trials", only, SETS)
    return {
        name: replace(of, trials=of.trials[: trials or None], is_brief=of.is_brief and not only)
        for name, of in evaluation_sets().items()
        if name in (only or SETS)
    }


def _graphs(trunks: list[str], random: bool) -> dict[str, bytes]:
    """Open trunks, each NAME=TRUNK or the name of an installed backbone, by the names of their rows.

    Errors: ConfigError.
    """
    pairs = [(name, trunk or name) for name, _, trunk in (word.partition("=") for word in trunks)]
    names = [name for name, _ in pairs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or "" in names:
        raise ConfigError(
            f"every trunk needs a different name, found {'twice ' + ', '.join(twice) if twice else 'an empty one'}; "
            "write NAME=TRUNK"
        )
    graphs = {name: open_trunk(trunk).graph for name, trunk in pairs}
    if random and RANDOM not in graphs:
        graphs[RANDOM] = random_trunk()
    return graphs
