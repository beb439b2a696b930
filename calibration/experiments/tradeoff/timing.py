"""Times of every point, interleaved: in each round every point scores one press, in an order that changes.

Directly before each press the bare reference trunk is run, and every stage is also divided by its time: what slows the
machine for a while slows both. Stages that are the same work (decoding one picture size, one trunk in one view) are
pooled over the points that share them, so that only what differs between two points makes their times differ.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint, View
from calibration.experiments.tradeoff.presses import mm_per_pixel
from calibration.fitting.trunks import open_trunk
from calibration.simulator.camera import CAMERA_QUALITY, encode_jpeg
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.region import CENTRE_SIDE
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions, open_session
from edge.pictures.press_picture import PressCaption, encode_press

__all__ = ["STAGES", "Lane", "Samples", "bundle_lanes", "camera_frames", "measure_rounds", "scale_of"]

STAGES: Final = ("decode", "trunk", "head", "overlay")
"""From camera bytes to the published picture: decode and cut, features, score map, picture of the press."""

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """Milliseconds."""

    stages: Float
    """float64 (stages, rounds, points)."""
    bare: Float
    """(rounds, points), the trunk run just before."""
    groups: NDArray[np.int64]
    """Per stage an id for each point, int64 (stages, points); points with equal ids did the same work."""

    @property
    def rounds(self) -> int:
        return len(self.bare)


@dataclass(frozen=True)
class Lane:
    """One point on its way from camera bytes to the picture of the press."""

    view: View
    frames: Sequence[CameraFrame]
    part: str
    score: Callable[[NDArray[np.uint8]], tuple[NDArray[np.float32], float, float, float]]
    """Score map and score of a region, and the milliseconds of trunk and head."""
    shared: tuple[object, object, object, object]
    """A key of each stage; lanes with equal keys do the same work in it."""
    threshold: float
    """Sets the scale of the colours."""

    def press(self, number: int) -> tuple[float, float, float, float]:
        """Return the milliseconds of each stage for one press."""
        profile = self.view.profile
        start = time.perf_counter()
        frame = self.frames[number % len(self.frames)]
        rgb = np.ascontiguousarray(self.view.region.crop(decode(frame, profile)))
        decoded = time.perf_counter()
        score_map, score, trunk_ms, head_ms = self.score(rgb)
        scored = time.perf_counter()
        caption = PressCaption(
            press_id="0" * 26,
            verdict="fail",
            score=score,
            threshold=self.threshold,
            mm_per_pixel=mm_per_pixel(profile),
            station="site/line/station",
            part=self.part,
            time="2026-01-01T00:00:00Z",
        )
        encode_press(rgb, score_map, caption)
        end = time.perf_counter()
        return (decoded - start) * 1e3, trunk_ms, head_ms, (end - scored) * 1e3


def scale_of(score_map: NDArray[np.float32]) -> float:
    """Return a threshold that gives pictures of such score maps colours."""
    return max(float(np.median(score_map)), 1e-6)


def bundle_lanes(
    points: Sequence[OperatingPoint],
    bundles: Sequence[Path],
    trunks_sha256: Sequence[str],
    frames: Mapping[str, Sequence[CameraFrame]],
    threads: int,
) -> list[Lane]:
    """Return a lane for each point with its bundle. frames: camera frames by the name of the profile."""
    trunks, lanes = TrunkSessions(threads), []
    for point, folder, sha256 in zip(points, bundles, trunks_sha256, strict=True):
        view, bundle = VIEWS[point.view], Bundle.load(folder, loaded=trunks)
        name, score = view.profile_name, partial(_score, Scorer(bundle, threads, trunks))
        part = f"{bundle.manifest.part}/{bundle.manifest.position}"
        grey = np.full((view.region.height, view.region.width, 3), 128, np.uint8)
        shared = (name, (sha256, view.name), point.key, name)
        lanes.append(Lane(view, frames[name], part, score, shared, scale_of(score(grey)[0])))
    return lanes


def _score(scorer: Scorer, rgb: NDArray[np.uint8]) -> tuple[NDArray[np.float32], float, float, float]:
    """Score as the gateway does."""
    scored = scorer.score(rgb)
    return scored.score_map, scored.anomaly_score, scored.trunk_ms, scored.head_ms


def measure_rounds(
    lanes: Sequence[Lane],
    *,
    threads: int,
    rounds: int,
    least: int,
    seed: int,
    until: float,
    advance: Callable[[int], None],
) -> Samples:
    """Time every lane in every round. advance: called with the rounds done.

    until: no round begins after this reading of the performance counter, once there are `least` of them.
    """
    bare_run = _bare(threads)
    stages = np.empty((len(STAGES), rounds, len(lanes)))
    bare = np.empty((rounds, len(lanes)))
    rng = np.random.default_rng(seed)
    for lane in lanes:
        lane.press(0)  # buffers and caches
    done = 0
    for number in range(rounds):
        if number >= least and time.perf_counter() > until:
            break
        for k in rng.permutation(len(lanes)):
            bare[number, k] = bare_run()
            stages[:, number, k] = lanes[k].press(number)
        done = number + 1
        advance(done)
    return Samples(stages[:, :done], bare[:done], _groups(lanes))


def _bare(threads: int) -> Callable[[], float]:
    """Runs `tactile_resnet18` alone on one frame of 224x224; gives its milliseconds."""
    session = open_session(open_trunk("tactile_resnet18").graph, threads, "trunk 'tactile_resnet18'")
    frame = np.random.default_rng(0).integers(0, 256, (1, CENTRE_SIDE, CENTRE_SIDE, 3), np.uint8)
    binding = session.io_binding()
    binding.bind_ortvalue_input("frames", ort.OrtValue.ortvalue_from_numpy(frame))
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")
    session.run_with_iobinding(binding)

    def run() -> float:
        start = time.perf_counter()
        session.run_with_iobinding(binding)
        return (time.perf_counter() - start) * 1e3

    return run


def _groups(lanes: Sequence[Lane]) -> NDArray[np.int64]:
    """Per stage an id for each lane; equal ids share the work."""
    by_stage = zip(*(lane.shared for lane in lanes), strict=True)
    return np.array([[list(dict.fromkeys(keys)).index(key) for key in keys] for keys in by_stage], np.int64)


def camera_frames(view: View, pictures: NDArray[np.uint8]) -> list[CameraFrame]:
    """Frames as the sensor would send them: the region's pixels (n, h, w, 3) put back into the camera's size.

    What lies outside the region is the region's mean colour, so a frame is slightly smaller than a real one.
    """
    return [
        CameraFrame(encode_jpeg(_in_camera(view, picture), CAMERA_QUALITY), 0, number)
        for number, picture in enumerate(pictures)
    ]


def _in_camera(view: View, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    (width, height), region = view.profile.size, view.region
    picture = np.full((height, width, 3), rgb.mean(axis=(0, 1)).astype(np.uint8), np.uint8)
    picture[region.y : region.y + region.height, region.x : region.x + region.width] = rgb
    (width, height), (x, y) = view.profile.native, view.profile.border
    left, top = int(width * x), int(height * y)
    inner = cv2.resize(picture, (width - 2 * left, height - 2 * top), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.copyMakeBorder(inner, top, top, left, left, cv2.BORDER_REPLICATE), np.uint8)
