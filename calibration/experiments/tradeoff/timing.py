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
from typing import Any

import cv2
import numpy as np

from calibration.dataset import LabelledPress
from calibration.experiments.tradeoff.front import WAITED, Row
from calibration.experiments.tradeoff.point import VIEWS, View
from calibration.simulator.camera import CAMERA_QUALITY, encode_jpeg
from edge.core.arrays import F64, U8
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions

__all__ = ["Lane", "bundle_lanes", "camera_frames", "measure_rounds", "stage_times"]

Shared = tuple[object, ...]


@dataclass(frozen=True)
class Lane:
    """One point on its way from camera bytes to the score, after which the verdict is a comparison."""

    view: View
    frames: Sequence[CameraFrame]
    score: Callable[[U8], tuple[float, float]]
    """Scores a region, uint8 (h, w, 3); returns the milliseconds of trunk and head."""
    shared: Shared
    """A key of each stage; lanes with equal keys do the same work in it."""

    def press(self, number: int) -> tuple[float, float, float]:
        """Return the milliseconds of each stage for one press."""
        start = time.perf_counter()
        frame = self.frames[number % len(self.frames)]
        rgb = np.ascontiguousarray(self.view.region.crop(decode(frame, self.view.profile)))
        decoded = time.perf_counter()
        return (decoded - start) * 1e3, *self.score(rgb)


def bundle_lanes(
    rows: Sequence[Row], folder: Path, frames: Mapping[tuple[int, int], Sequence[CameraFrame]], threads: int
) -> list[Lane]:
    """Return a lane for each row with the bundle of its name. frames: camera frames by the size of the profile."""
    trunks, lanes = TrunkSessions(threads), []
    for row in rows:
        view, bundle = VIEWS[row["view"]], Bundle.load(folder / row["key"], loaded=trunks)
        score = partial(_score, Scorer(bundle, threads, trunks))
        size = view.profile.size
        lanes.append(Lane(view, frames[size], score, (size, (row["trunk_sha256"], row["view"]), row["key"])))
    return lanes


def _score(scorer: Scorer, rgb: U8) -> tuple[float, float]:
    """Score as the gateway does."""
    scored = scorer.score(rgb)
    return scored.trunk_ms, scored.head_ms


def measure_rounds(
    lanes: Sequence[Lane], *, rounds: int, least: int, seed: int, until: float, advance: Callable[[int], None]
) -> F64:
    """Time every lane in every round, float64 (rounds, lanes, stages). advance: called with the rounds done.

    until: no round begins after this reading of the performance counter, once there are `least` of them.
    """
    ms = np.empty((rounds, len(lanes), len(WAITED)))
    rng = np.random.default_rng(seed)
    for lane in lanes:
        lane.press(0)  # buffers and caches
    for number in range(rounds):
        if number >= least and time.perf_counter() > until:
            return ms[:number]
        for k in rng.permutation(len(lanes)):
            ms[number, k] = lanes[k].press(number)
        advance(number + 1)
    return ms


def stage_times(ms: F64, shared: Sequence[Shared]) -> list[dict[str, Any]]:
    """Return the columns with the times of every lane. ms: as `measure_rounds` gives it. shared: of the lanes.

    Medians are pooled over lanes that share a stage, so a percentile is the median and how far above their median the
    lane's own rounds reach.
    """
    tails = np.percentile(ms, 95, axis=0) - np.median(ms, axis=0)
    columns = []
    for own, tail in zip(shared, tails, strict=True):
        alike = [[k for k, keys in enumerate(shared) if keys[stage] == key] for stage, key in enumerate(own)]
        medians = [float(np.median(ms[:, lanes, stage])) for stage, lanes in enumerate(alike)]
        stages = zip(WAITED, medians, tail.tolist(), strict=True)
        columns.append(
            {
                "stages": {name: {"median": median, "p95": median + more} for name, median, more in stages},
                "rounds": len(ms),
            }
        )
    return columns


def camera_frames(profile: SensorProfile, presses: Sequence[LabelledPress]) -> list[CameraFrame]:
    """Frames as the sensor would send them: pictures of presses, put back into the camera's size."""
    (width, height), (x, y) = profile.native, profile.border
    left, top = int(width * x), int(height * y)
    frames = []
    for number, press in enumerate(presses):
        inner = cv2.resize(press.rgb(), (width - 2 * left, height - 2 * top))
        whole = cv2.copyMakeBorder(inner, top, top, left, left, cv2.BORDER_REPLICATE)
        frames.append(CameraFrame(encode_jpeg(np.asarray(whole, np.uint8), CAMERA_QUALITY), 0, number))
    return frames
