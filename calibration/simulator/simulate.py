"""Making recordings and datasets from scenes: the library behind `gelgate lab simulate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from calibration.simulator.dataset_writer import write_dataset
from calibration.simulator.record import record_run
from calibration.simulator.scene import SCENES, NominalPieces, Scene, SceneRun, load_scene
from edge.core.detector import Progress
from edge.core.errors import ConfigError
from edge.validation_messages import sentences

__all__ = ["paper_scenes", "simulate_dataset", "simulate_recording"]

Table = TypeVar("Table", NominalPieces, SceneRun)


def paper_scenes() -> list[Scene]:
    """The scenes that together have the counts of the published dataset (its Table 1): PZ1 to PZ5."""
    return [load_scene(path) for path in sorted((SCENES / "paper").glob("*.toml"))]


def simulate_recording(
    scene: Scene,
    folder: Path,
    seed: int = 0,
    *,
    run: str | None = None,
    presses: int | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Path:
    """Write one run of a scene as a recording, and return its folder.

    run: the run's name, the first one if not given. presses: in place of the run's own number; damaged presses keep
    their share. An interrupted recording continues after its last complete press; a complete one is kept. Equal scene,
    run and seed give equal bytes. Errors: ConfigError for a scene without runs or an unknown run, RecordingError when
    the folder holds other things, StoreError for the disk.
    """
    return record_run(scene, _run(scene, run, presses), folder, seed, workers=workers, progress=progress)


def simulate_dataset(
    scenes: Scene | Sequence[Scene],
    folder: Path,
    seed: int = 0,
    *,
    presses: int | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Path:
    """Write one or more scenes as one dataset, and return its folder.

    presses: of each sound piece and position, in place of the scene's own. Existing files are kept. Errors: ConfigError
    for a scene of recordings, DatasetError when the folder holds other things, StoreError for the disk.
    """
    several = [scenes] if isinstance(scenes, Scene) else list(scenes)
    return write_dataset(
        [_set_presses(scene, presses) for scene in several], folder, seed, workers=workers, progress=progress
    )


def _set_presses(scene: Scene, presses: int | None) -> Scene:
    if scene.nominal is None:
        raise ConfigError(
            f"scene '{scene.name}' describes recordings; it has no [nominal] to make a dataset of"
        )
    if presses is None:
        return scene
    nominal = _with_presses(scene.nominal, {"presses": presses})
    return scene.model_copy(update={"nominal": nominal})


def _run(scene: Scene, name: str | None, presses: int | None) -> SceneRun:
    if not scene.runs:
        raise ConfigError(f"scene '{scene.name}' describes a dataset; it has no [[runs]] to record")
    chosen = scene.runs[0] if name is None else next((run for run in scene.runs if run.name == name), None)
    if chosen is None:
        raise ConfigError(
            f"scene '{scene.name}' has no run '{name}'; it has {', '.join(run.name for run in scene.runs)}"
        )
    if presses is None:
        return chosen
    faulty = min(presses - 1, round(chosen.faulty * presses / chosen.presses))
    return _with_presses(chosen, {"presses": presses, "faulty": faulty})


def _with_presses(table: Table, changes: dict[str, int]) -> Table:
    """The scene's table with other numbers, checked against the same limits."""
    try:
        return type(table).model_validate({**table.model_dump(), **changes})
    except ValidationError as error:
        raise ConfigError("; ".join(sentences(type(table), error))) from None
