"""Making recordings and datasets from scenes: the library behind `gelgate simulate`."""

from pathlib import Path

from calibration.scene import Run, Scene
from calibration.simulator.record import record_run
from edge.core.detector import Progress
from edge.core.errors import ConfigError

__all__ = ["simulate_recording"]


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
    their share. A recording that is already whole is left as it is; equal scene, run and seed give equal bytes.
    Errors: ConfigError for a scene without runs or an unknown run, RecordingError when the folder holds other things.
    """
    return record_run(scene, _run(scene, run, presses), folder, seed, workers=workers, progress=progress)


def _run(scene: Scene, name: str | None, presses: int | None) -> Run:
    if not scene.runs:
        raise ConfigError(f"scene '{scene.name}' describes a dataset; it has no [[runs]] to record")
    found = scene.runs[0] if name is None else next((run for run in scene.runs if run.name == name), None)
    if found is None:
        raise ConfigError(
            f"scene '{scene.name}' has no run '{name}'; it has {', '.join(run.name for run in scene.runs)}"
        )
    if presses is None:
        return found
    faulty = min(presses - 1, round(found.faulty * presses / found.presses))
    return Run(name=found.name, presses=presses, faulty=faulty, gel_presses=found.gel_presses)
