"""`gelgate lab simulate`: scenes in, recordings or a dataset out."""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from calibration.progress import Stages
from calibration.simulator.dataset_writer import simulate_dataset
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import EFFECTS
from calibration.simulator.parts import PARTS
from calibration.simulator.preview import write_preview
from calibration.simulator.record import simulate_recording
from calibration.simulator.scene import Scene, load_scene, paper_scenes, scene_names
from calibration.simulator.sensor_appearance import SENSORS
from calibration.simulator.sensor_file import find_sensor
from edge.core.errors import ConfigError

__all__ = ["simulate"]

SEEN_BY = {
    "illumination": "no relief shows",
    "noise": "frames are equal, as those of a camera that hangs",
}
"""The effects by which the presses of a recording are seen, each with what is missing without it."""


def _list(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo("\n".join(_list_scenes()))
        raise typer.Exit


def _list_scenes() -> Iterator[str]:
    """List the scenes that come with the product, and the names that a scene's file may use."""
    for name in scene_names():
        scene = load_scene(name)
        kind = "dataset" if scene.nominal else "recordings: " + ", ".join(run.name for run in scene.runs)
        yield f"{name:10}  {scene.part}  {kind}"
    yield "paper       all of paper/, into one dataset"
    yield "\nfor the file of a scene:"
    parts = (f"{name} ({' '.join(part.positions)})" for name, part in PARTS.items())
    yield f"  parts    {', '.join(parts)}"
    for what, names in (("defects", DEFECTS), ("effects", EFFECTS), ("sensors", SENSORS)):
        yield f"  {what}  {', '.join(names)}"


def simulate(
    scene: Annotated[
        str,
        typer.Argument(help="A scene's name or .toml file, or 'paper': the published dataset's counts."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Output folder: new, or one to continue; default: simulated/SCENE."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal bytes.")] = 0,
    presses: Annotated[
        int | None,
        typer.Option(min=1, help="Presses of each sound piece, or of each run, in place of the scene's."),
    ] = None,
    run: Annotated[
        str,
        typer.Option(
            help="Only this run, directly in the output folder; default: every run in its own folder."
        ),
    ] = "",
    sensor: Annotated[
        str, typer.Option(help="In place of the scene's: a sensor's name, or its file from `calibrate`.")
    ] = "",
    preview: Annotated[
        bool,
        typer.Option(
            "--preview", help="Only write <scene>_preview.png: frames, masks, its effects one by one."
        ),
    ] = False,
    workers: Annotated[int, typer.Option(min=0, max=64, help="Processes; 0 is one per core.")] = 0,
    is_listed: Annotated[
        bool,
        typer.Option("--list", callback=_list, is_eager=True, help="Print what can be simulated, and end."),
    ] = False,
) -> None:
    """Simulate presses as a dataset or as recordings. A dataset has exact masks, a recording every frame of a press.

    The same command continues an interrupted one; complete files are kept.
    """
    scenes = paper_scenes() if scene == "paper" else [load_scene(scene)]
    output = output or Path("simulated", Path(scene).stem)
    if sensor:
        chosen = find_sensor(sensor)
        scenes = [each.with_sensor(chosen) for each in scenes]
    workers = workers or os.cpu_count() or 1
    if preview:
        _preview(scenes, output, seed)
    elif scenes[0].runs:
        _recordings(scenes[0], output, seed, presses, run, workers)
    else:
        _dataset(scenes, output, seed, presses, run, workers)


def _dataset(
    scenes: list[Scene], output: Path, seed: int, presses: int | None, run: str, workers: int
) -> None:
    if run:
        raise ConfigError(f"scene '{scenes[0].name}' describes a dataset, which has no runs; leave --run out")
    with Stages() as report:
        show = partial(report, "simulate")
        simulate_dataset(scenes, output, seed, presses=presses, workers=workers, progress=show)
    typer.echo(f"dataset: {output}")


def _recordings(scene: Scene, output: Path, seed: int, presses: int | None, only: str, workers: int) -> None:
    for name in [only] if only else [run.name for run in scene.runs]:
        folder = output if only else output / name
        with Stages() as report:
            show = partial(report, f"simulate {name}")
            simulate_recording(scene, folder, seed, run=name, presses=presses, workers=workers, progress=show)
        typer.echo(f"recording: {folder}")
    for effect, what in SEEN_BY.items():
        if effect not in scene.effects:
            typer.echo(f"warning: a gateway finds no press: without the effect '{effect}' {what}", err=True)


def _preview(scenes: list[Scene], output: Path, seed: int) -> None:
    for scene in scenes:
        typer.echo(f"preview: {write_preview(scene, output, seed)}")
        left_out = [name for name in EFFECTS if name not in scene.effects]
        typer.echo(f"effects that {scene.name} does not use: {', '.join(left_out) or 'none'}")
