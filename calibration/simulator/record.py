"""A scene's run as a recording: every frame of every press as camera bytes, with its ground truth as a label."""

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from calibration.folders import claim, is_empty
from calibration.simulator.camera import CAMERA_QUALITY, encode_jpeg
from calibration.simulator.defects import Damaged
from calibration.simulator.field_of_view import HR, LR, native_field
from calibration.simulator.motion import Moment
from calibration.simulator.plan import PressPlan, damage, piece, recording_plan
from calibration.simulator.pose import Pose, sample
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.scene import Scene, SceneRun, change_counts
from calibration.simulator.streams import Streams
from calibration.simulator.workers import in_order
from edge.core.arrays import F32, U8
from edge.core.detector import Progress
from edge.core.errors import ConfigError, RecordingError
from edge.core.imaging.known_profiles import MINI_NATIVE
from edge.recording.format import DELIVERED_SHARE, Recording, RecordingHeader, RecordingWriter

__all__ = ["press_frames", "simulate_recording"]

# Names of a sensor that does not exist, in the maker's pattern.
_PRODUCT, _SERIAL = "GelSight Mini R0B SIM0-0001", "SIM00001"
_STAMP = "scene.json"
# Every JPEG ends with this marker (ITU-T T.81, B.1.1.3: EOI).
_JPEG_END = b"\xff\xd9"

Label = Mapping[str, object]
FrameOut = tuple[int, bytes, Label]
"""Nanoseconds since the recording began, the camera's bytes, the label."""


@dataclass(frozen=True)
class _Task:
    """Frames of one press, or of the free gel before the first and after the last (`press` is None)."""

    scene: Scene
    seed: int
    index: int
    first_frame: int
    press: PressPlan | None
    previous: PressPlan | None = None
    idle_frames: int = 0
    gel_presses: int = 0


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
    their share. It is rendered in `<folder>.part` and renamed when it is complete. An interrupted one continues after
    its last complete press; a complete recording of the same scene, run and seed is kept. Equal scene, run and seed
    give equal bytes. Errors: ConfigError for a scene without runs or an unknown run, RecordingError when either folder
    holds anything else, StoreError for the disk.
    """
    return _record(scene, _find_run(scene, run, presses), folder, seed, workers, progress)


def _find_run(scene: Scene, name: str | None, presses: int | None) -> SceneRun:
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
    return change_counts(chosen, presses=presses, faulty=faulty)


def _record(
    scene: Scene, run: SceneRun, folder: Path, seed: int, workers: int, progress: Progress | None
) -> Path:
    text = scene.model_dump_json() + run.model_dump_json()
    digest = hashlib.sha256(text.encode()).hexdigest()
    stamp = {"version": 1, "scene": scene.name, "run": run.name, "seed": seed, "sha256": digest}
    if not is_empty(folder, "", RecordingError):
        claim(folder, _STAMP, stamp, "recording", RecordingError)
        Recording.open(folder)
        return folder
    unfinished = folder.with_name(folder.name + ".part")
    way_on = "move it away, or finish it with the command that began it"
    claim(unfinished, _STAMP, stamp, "unfinished recording", RecordingError, way_on)
    tasks = list(_tasks(scene, run, seed))
    complete = _complete_frames(unfinished)
    # A press is complete when the next one could begin; the free gel after the last press is cheap and is made again.
    kept = sum(following.first_frame <= complete for following in tasks[1:])
    with RecordingWriter.resume(unfinished, _header(scene), keep=tasks[kept].first_frame) as writer:
        for done, frames in enumerate(in_order(_frames, tasks[kept:], workers), kept + 1):
            for time_ns, payload, label in frames:
                writer.add(payload, time_ns, label)
            if progress is not None:
                progress(done / len(tasks))
    if folder.is_dir():
        folder.rmdir()
    os.replace(unfinished, folder)
    return folder


def _complete_frames(unfinished: Path) -> int:
    """Count the frames that are complete from the first on; 0 where the recording cannot be read."""
    try:
        frames = Recording.open(unfinished)
    except RecordingError:
        return 0
    # After a power cut the index may have a line whose picture is not on the disk.
    cut = (k for k, frame in enumerate(frames) if not frame.frame.payload.endswith(_JPEG_END))
    return next(cut, len(frames))


def _header(scene: Scene) -> RecordingHeader:
    mode = scene.camera.modes[0]
    sizes = {"lr": LR.size, "hr": HR.size, "native": MINI_NATIVE}
    profile = {"lr": "cropped_lr", "hr": "", "native": "mini_lr"}[mode]
    return RecordingHeader(_PRODUCT, _SERIAL, sizes[mode], scene.camera.fps / DELIVERED_SHARE, profile)


def _tasks(scene: Scene, run: SceneRun, seed: int) -> Iterator[_Task]:
    each = scene.motion.count_frames(scene.camera.fps)
    idle = round(scene.motion.idle_s * scene.camera.fps)
    plans = recording_plan(scene, run, seed, each / scene.camera.fps)
    yield _Task(scene, seed, -1, 0, None, idle_frames=idle, gel_presses=run.gel_presses)
    for index, plan in enumerate(plans):
        previous = plans[index - 1] if index else None
        yield _Task(scene, seed, index, idle + index * each, plan, previous)
    end, tail = idle + len(plans) * each, round(scene.motion.tail_s * scene.camera.fps)
    yield _Task(scene, seed, -1, end, None, plans[-1], tail, run.gel_presses + run.presses)


@lru_cache(maxsize=2)
def _renderer(scene: Scene, seed: int) -> Renderer:
    mode = scene.camera.modes[0]
    field = {"lr": LR, "hr": HR, "native": native_field(scene.camera.reduction)}[mode]
    # The bytes of a recording are always JPEG: the effect only chooses their quality.
    effects = tuple(name for name in scene.effects if name != "jpeg")
    sensor = scene.camera.appearance
    return Renderer(field, effects, sensor, scene.press_jitter, Streams(seed), session=scene.name)


def _frames(task: _Task) -> list[FrameOut]:
    with reproducible_opencv():
        if task.press is None:
            return _idle_frames(task)
        return list(
            press_frames(task.scene, task.seed, task.index, task.first_frame, task.press, task.previous)
        )


def _idle_frames(task: _Task) -> list[FrameOut]:
    renderer, scene, worn = _renderer(task.scene, task.seed), task.scene, task.gel_presses
    free = np.zeros(renderer.field.shape, dtype=np.float32)
    left = _residual_imprint(task.previous, scene, task.seed)
    label: Label = {"press": None, "phase": "idle", "specimen": None, "defect": None, "severity": 0.0}
    frames = []
    light = None
    for k in range(task.idle_frames):
        time_s = (task.first_frame + k) / scene.camera.fps
        if light is None or left is not None:
            previous = None if left is None else (left, k / scene.camera.fps)
            light = renderer.light(renderer.surface(free, worn, previous), worn)
        rgb = renderer.expose(light, ("idle", worn), Exposure(k, time_s, (0.0, 0.0)))
        frames.append((round(time_s * 1e9), _payload(scene, rgb), label))
    return frames


def press_frames(
    scene: Scene, seed: int, index: int, first_frame: int, plan: PressPlan, previous: PressPlan | None
) -> Iterator[FrameOut]:
    """The frames of one press, in order. index: which press of the run, from 0. first_frame: of its first frame."""
    renderer, streams, fps = _renderer(scene, seed), Streams(seed), scene.camera.fps
    defect = damage(plan, scene, streams)
    sound = piece(plan, streams)
    placed = renderer.place(Pose(), plan.key)
    height = sample(sound if defect is None else Damaged(sound, defect), placed, renderer.field)
    depth = scene.press_depth_mm * placed.depth_factor
    angle = (
        float(streams("motion_blur", *plan.key).uniform(0, 2 * np.pi))
        if "motion_blur" in scene.effects
        else 0.0
    )
    left = _residual_imprint(previous, scene, seed)
    light, shown = None, None
    for k, moment in enumerate(scene.motion.moments(fps)):
        state = (moment.depth, moment.since_release_s if left is not None and moment.depth == 0 else None)
        if light is None or state != shown:
            light, shown = _light(renderer, height, depth, moment, plan, left), state
        time_s = (first_frame + k) / fps
        slide = (moment.slide_mm_s * np.cos(angle), moment.slide_mm_s * np.sin(angle))
        rgb = renderer.expose(light, plan.key, Exposure(k, time_s, slide))
        yield (
            round(time_s * 1e9),
            _payload(scene, rgb),
            _label(index, moment, plan, None if defect is None else asdict(defect)),
        )


def _light(
    renderer: Renderer, height: F32, depth_mm: float, moment: Moment, plan: PressPlan, left: F32 | None
) -> F32:
    if moment.depth > 0:
        imprint = renderer.imprint(height, depth_mm * moment.depth)
        previous = None
    else:
        imprint = np.zeros(renderer.field.shape, dtype=np.float32)
        previous = None if left is None else (left, moment.since_release_s)
    return renderer.light(renderer.surface(imprint, plan.gel_presses, previous), plan.gel_presses)


def _residual_imprint(previous: PressPlan | None, scene: Scene, seed: int) -> F32 | None:
    """The imprint of the previous press, where the scene names `residual_imprint`."""
    if previous is None or "residual_imprint" not in scene.effects:
        return None
    renderer, streams = _renderer(scene, seed), Streams(seed)
    placed = renderer.place(Pose(), previous.key)
    height = sample(piece(previous, streams), placed, renderer.field)
    return renderer.imprint(height, scene.press_depth_mm * placed.depth_factor)


def _label(index: int, moment: Moment, plan: PressPlan, defect: Mapping[str, object] | None) -> Label:
    return {
        "press": index,
        "phase": moment.phase,
        "specimen": f"s{plan.specimen:03d}",
        "part": plan.part,
        "position": plan.position,
        "defect": None
        if defect is None
        else {key: defect[key] for key in ("kind", "severity", "at_mm", "turn_rad")},
        "severity": plan.severity,
    }


# Compression without visible loss, for a scene without the effect: the bytes are JPEG in every case.
_FINE_QUALITY = 98


def _payload(scene: Scene, rgb: U8) -> bytes:
    """The camera's bytes: scaled up to the camera's size where the scene renders its native mode."""
    size = MINI_NATIVE if "native" in scene.camera.modes else None
    return encode_jpeg(rgb, CAMERA_QUALITY if "jpeg" in scene.effects else _FINE_QUALITY, size)
