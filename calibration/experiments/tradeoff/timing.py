"""Times of every point, interleaved: in each round every point scores one press, in an order that changes.

Stages that are the same work (decoding one picture size, one trunk in one view) are pooled over the points that share
them, so that only what differs between two points makes their times differ. The picture of a press leaves after its
verdict and is not timed here; `gelgate lab bench` has it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.experiments.tradeoff.front import WAITED
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint, View
from calibration.simulator.camera import CAMERA_QUALITY, encode_jpeg
from edge.core.arrays import F64, U8
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions

__all__ = ["Lane", "Samples", "Score", "bundle_lanes", "camera_frames", "measure_rounds"]


@dataclass(frozen=True)
class Samples:
    """Milliseconds."""

    stages: F64
    """float64 (stages, rounds, points)."""
    groups: NDArray[np.int64]
    """Per stage an id for each point, int64 (stages, points); points with equal ids did the same work."""


Score = Callable[[U8], tuple[float, float]]
"""Scores a region, uint8 (h, w, 3); returns the milliseconds of trunk and head."""


@dataclass(frozen=True)
class Lane:
    """One point on its way from camera bytes to the score, after which the verdict is a comparison."""

    view: View
    frames: Sequence[CameraFrame]
    score: Score
    shared: tuple[object, object, object]
    """A key of each stage; lanes with equal keys do the same work in it."""

    def press(self, number: int) -> tuple[float, float, float]:
        """Return the milliseconds of each stage for one press."""
        start = time.perf_counter()
        frame = self.frames[number % len(self.frames)]
        rgb = np.ascontiguousarray(self.view.region.crop(decode(frame, self.view.profile)))
        decoded = time.perf_counter()
        return (decoded - start) * 1e3, *self.score(rgb)


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
        lanes.append(Lane(view, frames[name], score, (name, (sha256, view.name), point.key)))
    return lanes


def _score(scorer: Scorer, rgb: U8) -> tuple[float, float]:
    """Score as the gateway does."""
    scored = scorer.score(rgb)
    return scored.trunk_ms, scored.head_ms


def measure_rounds(
    lanes: Sequence[Lane],
    *,
    rounds: int,
    least: int,
    seed: int,
    until: float,
    advance: Callable[[int], None],
) -> Samples:
    """Time every lane in every round. advance: called with the rounds done.

    until: no round begins after this reading of the performance counter, once there are `least` of them.
    """
    stages = np.empty((len(WAITED), rounds, len(lanes)))
    rng = np.random.default_rng(seed)
    for lane in lanes:
        lane.press(0)  # buffers and caches
    done = 0
    for number in range(rounds):
        if number >= least and time.perf_counter() > until:
            break
        for k in rng.permutation(len(lanes)):
            stages[:, number, k] = lanes[k].press(number)
        done = number + 1
        advance(done)
    return Samples(stages[:, :done], _groups(lanes))


def _groups(lanes: Sequence[Lane]) -> NDArray[np.int64]:
    """Per stage an id for each lane; equal ids share the work."""
    by_stage = zip(*(lane.shared for lane in lanes), strict=True)
    return np.array([[list(dict.fromkeys(keys)).index(key) for key in keys] for keys in by_stage], np.int64)


def camera_frames(view: View, pictures: U8) -> list[CameraFrame]:
    """Frames as the sensor would send them: the region's pixels (n, h, w, 3) put back into the camera's size.

    What lies outside the region is the region's mean colour, so a frame is slightly smaller than a real one.
    """
    return [
        CameraFrame(encode_jpeg(_in_camera(view, picture), CAMERA_QUALITY), 0, number)
        for number, picture in enumerate(pictures)
    ]


def _in_camera(view: View, rgb: U8) -> U8:
    (width, height), region = view.profile.size, view.region
    picture = np.full((height, width, 3), rgb.mean(axis=(0, 1)).astype(np.uint8), np.uint8)
    picture[region.y : region.y + region.height, region.x : region.x + region.width] = rgb
    (width, height), (x, y) = view.profile.native, view.profile.border
    left, top = int(width * x), int(height * y)
    inner = cv2.resize(picture, (width - 2 * left, height - 2 * top), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.copyMakeBorder(inner, top, top, left, left, cv2.BORDER_REPLICATE), np.uint8)
