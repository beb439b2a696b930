"""Scenes as a dataset in the published layout; an interrupted run continues where it stopped.

    dataset.json                        version, seed, scenes, counts, faults
    <part>/<position>/rgb               1280x720 sound presses (where the scene has the mode hr)
    <part>/<position>/rgb_320x240       320x240 sound presses (mode lr)
    <part>/<position>/fault/...         the same two, and mask, mask_320x240: 0 sound, 255 where the imprint differs

Files are named <part>_<position>_s<specimen>_p<press>.png; a mask has the name of its picture. Every file is written
under a temporary name and then renamed, so a file that exists is complete and is kept.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np

from calibration.dataset.files import pool_mask
from calibration.dataset.opening import DATASET_VERSION, SUMMARY_FILE
from calibration.folders import claim, write_whole
from calibration.simulator.field_of_view import HR, LR, Field
from calibration.simulator.plan import PressPlan, damage, dataset_plan, piece
from calibration.simulator.pose import Pose
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.scene import Scene, change_counts
from calibration.simulator.streams import Streams
from calibration.simulator.workers import in_order
from edge.core.arrays import U8, Mask
from edge.core.detector import Progress
from edge.core.errors import ConfigError, DatasetError, StoreError

__all__ = ["outputs", "press_pictures", "simulate_dataset"]

# Noise does not compress: the fastest setting gives files 3 % larger than the slowest.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class _Task:
    """One piece at one position: all its presses."""

    scene: Scene
    seed: int
    folder: Path
    presses: tuple[PressPlan, ...]


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

    presses: of each sound piece and position, in place of the scene's own. Complete files are kept. Errors: ConfigError
    for a scene of recordings, DatasetError when the folder holds anything but this dataset, StoreError for the disk.
    """
    several = [scenes] if isinstance(scenes, Scene) else scenes
    plans = {scene: dataset_plan(scene, seed) for scene in (_set_presses(each, presses) for each in several)}
    summary = _summary(plans, seed)
    claim(folder, SUMMARY_FILE, summary, "simulated dataset", DatasetError)
    tasks = [
        _Task(scene, seed, folder, tuple(group))
        for scene, presses in plans.items()
        for _, group in groupby(presses, key=lambda plan: (plan.position, plan.specimen))
    ]
    total = sum(len(task.presses) for task in tasks)
    done = 0
    try:
        for count in in_order(_write_piece, tasks, workers):
            done += count
            if progress is not None:
                progress(done / total)
        text = json.dumps({**summary, "complete": True}, indent=1) + "\n"
        write_whole(folder / SUMMARY_FILE, text.encode())
    except OSError as error:
        raise StoreError(
            f"dataset {folder} stops after {done} of {total} presses: {error.strerror}; "
            "they are kept; free some space and run the same command again"
        ) from error
    return folder


def _set_presses(scene: Scene, presses: int | None) -> Scene:
    if scene.nominal is None:
        raise ConfigError(
            f"scene '{scene.name}' describes recordings; it has no [nominal] to make a dataset of"
        )
    if presses is None:
        return scene
    return scene.model_copy(update={"nominal": change_counts(scene.nominal, presses=presses)})


def _summary(plans: Mapping[Scene, list[PressPlan]], seed: int) -> dict[str, object]:
    scenes = [
        {
            "name": scene.name,
            "part": scene.part,
            "positions": list(scene.at),
            "modes": list(scene.camera.modes),
            "effects": list(scene.effects),
            "mask_depth_mm": scene.mask_depth_mm,
            "sha256": hashlib.sha256(scene.model_dump_json().encode()).hexdigest(),
            "counts": {
                position: {
                    "nominal": sum(p.position == position and not p.kind for p in presses),
                    "faulty": sum(p.position == position and bool(p.kind) for p in presses),
                }
                for position in scene.at
            },
        }
        for scene, presses in plans.items()
    ]
    faults = {
        plan.name: {"kind": plan.kind, "severity": plan.severity}
        for presses in plans.values()
        for plan in presses
        if plan.kind
    }
    return {
        "version": DATASET_VERSION,
        "source": "gelgate lab simulate",
        "profile": "cropped_lr",
        "seed": seed,
        "mm_per_px": {"320x240": list(LR.mm_per_px), "1280x720": list(HR.mm_per_px)},
        "scenes": scenes,
        "faults": dict(sorted(faults.items())),
        "complete": False,
    }


def outputs(scene: Scene, plan: PressPlan) -> dict[str, Path]:
    """Name the files of a press, relative to the dataset's root; keys such as `rgb` and `mask_320x240`."""
    kinds = [name for mode, name in (("hr", "rgb"), ("lr", "rgb_320x240")) if mode in scene.camera.modes]
    base = Path(plan.part) / plan.position
    if plan.kind:
        base /= "fault"
        kinds += [name.replace("rgb", "mask") for name in kinds]
    return {kind: base / kind / f"{plan.name}.png" for kind in kinds}


def _write_piece(task: _Task) -> int:
    with reproducible_opencv():
        for plan in task.presses:
            paths = {kind: task.folder / path for kind, path in outputs(task.scene, plan).items()}
            if all(path.is_file() for path in paths.values()):
                continue
            for kind, picture in press_pictures(task.scene, plan, task.seed):
                write_whole(paths[kind], _png(picture))
    return len(task.presses)


@lru_cache(maxsize=2)
def _renderer(scene: Scene, seed: int, field: Field, gel: str, position: str) -> Renderer:
    sensor = scene.camera.appearance
    return Renderer(field, scene.effects, sensor, scene.press_jitter, Streams(seed), gel, position)


def press_pictures(scene: Scene, plan: PressPlan, seed: int) -> Iterator[tuple[str, U8]]:
    """The pictures of one press: (`rgb`, `rgb_320x240`, `mask`, ...) and uint8 (h, w, 3) or (h, w).

    Where the scene has both sizes, the small one is the large one area-averaged, and its mask is true where any pixel
    of the 4x3 block is.
    """
    is_large = "hr" in scene.camera.modes
    renderer = _renderer(scene, seed, HR if is_large else LR, plan.gel, plan.position)
    streams = Streams(seed)
    sound, exposure = piece(plan, streams), Exposure(0, plan.time_s)
    defect = damage(plan, scene, streams)
    depth, key, worn = scene.press_depth_mm, plan.key, plan.gel_presses
    mask = None
    if defect is None:
        rgb = renderer.press(sound, depth, key, Pose(), worn, exposure)
    else:
        rgb, mask = renderer.damage(sound, defect, depth, key, Pose(), worn, exposure, scene.mask_depth_mm)
    if is_large:
        yield "rgb", rgb
        if mask is not None:
            yield "mask", _as_mask(mask)
    if "lr" in scene.camera.modes:
        yield "rgb_320x240", (np.asarray(cv2.resize(rgb, LR.size, interpolation=cv2.INTER_AREA), np.uint8))
        if mask is not None:
            yield "mask_320x240", _as_mask(pool_mask(mask, LR.shape))


def _as_mask(mask: Mask) -> U8:
    return mask.astype(np.uint8) * np.uint8(255)


def _png(picture: U8) -> bytes:
    ordered = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    done, data = cv2.imencode(".png", ordered, _PNG)
    if not done:
        raise ValueError(f"a picture of shape {picture.shape} cannot be encoded as PNG")
    return bytes(data)
