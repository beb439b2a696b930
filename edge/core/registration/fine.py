"""The fine pose: Gauss-Newton on the difference of slopes, with the part's own derivatives at every round.

Source: Baker and Matthews 2004, "Lucas-Kanade 20 years on", the inverse compositional form. Only the places whose
slopes change most with the pose are read: they carry nearly all of the information. A part pressed deeper shows steeper
slopes, so the part is scaled to the press. Several poses are refined at once, for one costs nearly as much as six.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edge.core.arrays import F32, F64
from edge.core.registration.pose import Pose, depth_inside, turn_slopes

__all__ = ["Alignment", "FineSearch"]

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

    covariance: float64 (3, 3) of the pose's x, y (pixels) and turn (radians), from what differs after the alignment.
    """

    pose: Pose
    match: float
    covariance: F64


class FineSearch:
    """A part at one scale. slopes: float32 (h, w, 2) of the part. is_turning: False keeps the turn that is given."""

    def __init__(self, slopes: F32, is_turning: bool = True) -> None:
        h, w = slopes.shape[:2]
        self.slopes, self._h, self._w = slopes, h, w
        derivatives = _derivatives(slopes, is_turning)
        change = (derivatives**2).sum(axis=(0, 3)).ravel()
        count = min(_PLACES, h * w) // _ROW * _ROW or h * w
        at = np.sort(np.argpartition(change, h * w - count)[h * w - count :])
        # Two planes of slopes one after the other, so that a place's weight is the same row of each.
        chosen = derivatives.reshape(3, -1, 2)[:, at]
        self._columns = chosen.transpose(2, 1, 0).reshape(-1, 3)
        self._part = slopes.reshape(-1, 2)[at].T.ravel()
        # What a place adds to the normal matrix and to the part's energy, if it is seen.
        squares = np.einsum("ips,jps->pij", chosen, chosen).reshape(-1, 9)
        energy = (slopes.reshape(-1, 2)[at] ** 2).sum(axis=1, keepdims=True)
        self._sums = np.concatenate([squares, energy], axis=1)
        self._places = np.stack([at % w, at // w, np.ones_like(at)]).astype(np.float64)
        scale = np.array([1.0, 1.0, float(max(h, w)) ** 2])
        self._prior = np.diag(_PRIOR * scale)

    def refine(self, slopes: F32, poses: Sequence[Pose], rounds: int) -> list[Pose]:
        """Refine the poses in that many rounds. slopes: of a press, in the size of the part's."""
        refined = list(poses)
        for _ in range(rounds):
            steps, _ = self._steps(*self._read(slopes, refined))
            refined = [pose.after(step) for pose, step in zip(refined, steps, strict=True)]
        return refined

    def refine_best(self, slopes: F32, poses: Sequence[Pose], rounds: int, most: int) -> list[Pose]:
        """Refine the poses in one round, and in the others those alone that then match best, at most so many."""
        near = self.refine(slopes, poses, 1)
        moved, weight = self._read(slopes, near)
        energy = (weight @ self._sums[:, 9]) * (moved**2).sum(axis=1)
        match = (moved @ self._part) / np.sqrt(np.maximum(energy, _TINY))
        best = np.argsort(-match, kind="stable")[:most]
        return self.refine(slopes, [near[k] for k in best], rounds - 1)

    def agreement(self, slopes: F32, pose: Pose) -> tuple[float, float]:
        """The match over all places that are seen, and the share of the press's energy in the bank's field."""
        moved = turn_slopes(slopes, pose)
        is_seen = (depth_inside(pose, (self._w, self._h)) >= 0).view(np.uint8)
        part = np.asarray(cv2.copyTo(self.slopes, is_seen), np.float32)  # 0 elsewhere
        energy = float(np.vdot(moved, moved))
        moved = np.asarray(cv2.copyTo(moved, is_seen), np.float32)
        inside = energy / max(float(np.vdot(slopes, slopes)), _TINY)
        return _correlation(part, moved), min(inside, 1.0)

    def settle(self, slopes: F32, pose: Pose, rounds: int, still_px: float) -> tuple[Pose, F64]:
        """Refine a pose in that many rounds, or until one moves no place by more; give its covariance too."""
        for _ in range(rounds):
            (step,), (covariance,) = self._steps(*self._read(slopes, [pose]))
            pose = pose.after(step)
            if math.hypot(step.x_px, step.y_px) + abs(step.turn_rad) * max(self._h, self._w) / 2 <= still_px:
                break
        return pose, covariance

    def align(self, slopes: F32, pose: Pose, rounds: int, still_px: float = 0) -> Alignment:
        """Align a pose as `settle` does; give its match over all places and the covariance of the last round."""
        pose, covariance = self.settle(slopes, pose, rounds, still_px)
        turn = np.eye(3)  # a round moves the part before its turn, and the pose is a shift after it
        turn[:2, :2] = pose.matrix((self._w, self._h))[:, :2]
        return Alignment(pose, self.agreement(slopes, pose)[0], turn @ covariance @ turn.T)

    def _read(self, slopes: F32, poses: Sequence[Pose]) -> tuple[F32, F32]:
        """The press at the places in these poses, float32 (n, 2 * places), and 1 where it is seen, (n, places)."""
        x, y = np.stack([pose.matrix((self._w, self._h)) for pose in poses], axis=1) @ self._places
        is_seen = (x >= 0) & (x <= self._w - 1) & (y >= 0) & (y <= self._h - 1)
        columns, rows = (axis.astype(np.float32).reshape(-1, min(_ROW, x.shape[1])) for axis in (x, y))
        read = np.asarray(cv2.remap(slopes, columns, rows, cv2.INTER_LINEAR), np.float32).reshape(*x.shape, 2)
        turns = np.array([pose.turn_rad for pose in poses])
        cos, sin = np.cos(turns).astype(np.float32)[:, None], np.sin(turns).astype(np.float32)[:, None]
        across, down, weight = read[..., 0], read[..., 1], is_seen.astype(np.float32)
        turned = [(cos * across + sin * down) * weight, (cos * down - sin * across) * weight]
        return np.concatenate(turned, axis=1), weight

    def _steps(self, moved: F32, weight: F32) -> tuple[list[Pose], F64]:
        """Compute for each pose the part's move that explains the press best, and its covariance (n, 3, 3)."""
        sums = (weight @ self._sums).astype(np.float64)
        gain = np.maximum((moved @ self._part) / np.maximum(sums[:, 9], _TINY), _LEAST_GAIN)
        error = moved - gain[:, None].astype(np.float32) * (
            self._part * np.concatenate([weight, weight], axis=1)
        )
        normal = sums[:, :9].reshape(-1, 3, 3) * (gain**2)[:, None, None]
        prior = self._prior * np.maximum(normal[:, 0, 0] + normal[:, 1, 1], _TINY)[:, None, None]
        solved = np.linalg.inv(normal + prior)
        moves = np.einsum("nij,nj->ni", solved, gain[:, None] * (error @ self._columns))
        longest = _STEP_SHARE * max(self._h, self._w)
        most = np.array([longest, longest, _STEP_RAD])
        steps = [Pose(*move) for move in np.clip(moves, -most, most).tolist()]
        # Two slopes a place, and neighbouring places err alike: as many independent values as places.
        spread = (error**2).sum(axis=1) / np.maximum(1.0, weight.sum(axis=1))
        return steps, solved * spread[:, None, None]


def _derivatives(slopes: F32, is_turning: bool) -> F32:
    """Differentiate a part's slopes by its move right, down and clockwise, float32 (3, h, w, 2)."""
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
