"""The fine pose: Gauss-Newton on the difference of slopes, with the part's own derivatives at every round.

Source: Baker and Matthews 2004, "Lucas-Kanade 20 years on", the inverse compositional form. Only the places whose
slopes change most with the pose are read: they carry nearly all of the information. A part pressed deeper shows steeper
slopes, so the part is scaled to the press.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.registration.pose import Pose, turned_slopes, warped

__all__ = ["Alignment", "FineSearch"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Places that are read, and how many of them cv2.remap takes as a row.
_PLACES, _ROW = 1024, 64
# A weak prior against any change: a direction along which the part looks the same keeps its first value.
_PRIOR = 1e-3
# Longest step of a round, as a share of the side and in radians; beyond it the derivatives do not hold.
_STEP_SHARE, _STEP_RAD = 0.05, 0.15
# A pressed part is at least this share as steep as the learnt one; below it the derivatives would vanish.
_LEAST_GAIN = 0.1
_TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True, eq=False)
class Alignment:
    """pose: in pixels of the slopes. match: correlation of the slopes where both are seen, at most 1.

    covariance: float64 (3, 3) of x, y (pixels) and turn (radians), from what differs after the alignment.
    """

    pose: Pose
    match: float
    covariance: F64


class FineSearch:
    """A part at one scale. slopes: float32 (h, w, 2) of the part. is_turning: False keeps the turn that is given."""

    def __init__(self, slopes: F32, is_turning: bool = True) -> None:
        h, w = slopes.shape[:2]
        self._slopes, self._h, self._w = slopes, h, w
        derivatives = _derivatives(slopes, is_turning)
        change = (derivatives**2).sum(axis=(0, 3)).ravel()
        count = min(_PLACES, h * w) // _ROW * _ROW or h * w
        at = np.sort(np.argpartition(change, h * w - count)[h * w - count :])
        # Two planes of slopes one after the other, so that a place's weight is the same row of each.
        self._columns = derivatives.reshape(3, -1, 2)[:, at].transpose(0, 2, 1).reshape(3, -1)
        self._part = slopes.reshape(-1, 2)[at].T.ravel()
        self._places = np.stack([at % w, at // w, np.ones_like(at)]).astype(np.float64)

    def refined(self, slopes: F32, pose: Pose, rounds: int) -> Pose:
        """The pose after that many rounds. slopes: of a press, in the size of the part's."""
        for _ in range(rounds):
            pose = pose.after(self._step(*self._read(slopes, pose))[0])
        return pose

    def agreement(self, slopes: F32, pose: Pose) -> tuple[float, float]:
        """The match over all places that are seen, and the share of the press's energy in the bank's field."""
        moved = turned_slopes(slopes, pose)
        weight = (warped(np.ones(slopes.shape[:2], np.float32), pose) > 0.99).astype(np.float32)[..., None]
        inside = float(np.vdot(moved, moved)) / max(float(np.vdot(slopes, slopes)), _TINY)
        return _correlation(self._slopes * weight, moved * weight), min(inside, 1.0)

    def aligned(self, slopes: F32, pose: Pose, rounds: int) -> Alignment:
        """The pose after that many rounds, with its match over all places and its covariance."""
        pose = self.refined(slopes, pose, rounds)
        match, _ = self.agreement(slopes, pose)
        return Alignment(pose, match, self._step(*self._read(slopes, pose))[1])

    def _read(self, slopes: F32, pose: Pose) -> tuple[F32, F32]:
        """The press at the places, in this pose, and 1 where it is seen there, float32 (2 * places,) each."""
        x, y = pose.matrix((self._w, self._h)) @ self._places
        is_seen = (x >= 0) & (x <= self._w - 1) & (y >= 0) & (y <= self._h - 1)
        at = np.stack([x, y], axis=-1).astype(np.float32).reshape(-1, min(_ROW, len(x)), 2)
        across, down = cv2.remap(slopes, at, None, cv2.INTER_LINEAR).reshape(-1, 2).T  # type: ignore[call-overload]
        cos, sin = math.cos(pose.turn_rad), math.sin(pose.turn_rad)
        weight = np.tile(is_seen, 2).astype(np.float32)
        return np.concatenate([cos * across + sin * down, cos * down - sin * across]) * weight, weight

    def _step(self, moved: F32, weight: F32) -> tuple[Pose, F64]:
        """The part's move that explains the press best, and the covariance of that move."""
        part = self._part * weight
        gain = max(float(part @ moved) / max(float(part @ part), _TINY), _LEAST_GAIN)
        error = moved - np.float32(gain) * part
        columns = self._columns * (np.float32(gain) * weight)
        normal = (columns @ columns.T).astype(np.float64)
        scale = np.array([1.0, 1.0, float(max(self._h, self._w)) ** 2])
        prior = np.diag(_PRIOR * scale) * max(normal[0, 0] + normal[1, 1], _TINY)
        solved = np.linalg.inv(normal + prior)
        x, y, turn = (solved @ (columns @ error).astype(np.float64)).tolist()
        longest = _STEP_SHARE * max(self._h, self._w)
        step = Pose(_within(x, longest), _within(y, longest), _within(turn, _STEP_RAD))
        # Two slopes a place, and neighbouring places err alike: as many independent values as places.
        return step, solved * float(error @ error) / max(1.0, float(weight.sum()) / 2)


def _derivatives(slopes: F32, is_turning: bool) -> F32:
    """Of a part's slopes by its move right, down and clockwise, float32 (3, h, w, 2)."""
    h, w = slopes.shape[:2]
    across = cv2.Sobel(slopes, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    down = cv2.Sobel(slopes, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    y, x = np.mgrid[:h, :w].astype(np.float32)
    x, y = (x - (w - 1) / 2)[..., None], (y - (h - 1) / 2)[..., None]
    # The part turns about the centre, and its slopes turn with it.
    turning = np.stack([-slopes[..., 1], slopes[..., 0]], axis=-1) + across * y - down * x
    return np.stack([-across, -down, turning * np.float32(is_turning)])


def _correlation(one: F32, other: F32) -> float:
    energy = float(np.vdot(one, one)) * float(np.vdot(other, other))
    return float(np.vdot(one, other)) / max(math.sqrt(energy), _TINY)


def _within(value: float, longest: float) -> float:
    return min(max(value, -longest), longest)
