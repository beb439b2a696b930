"""Learns from nominal presses how a part is found under the gel, and brings the presses to one pose.

One press is the first template; the mean of all presses in its pose is the next. The colours of slopes come from the
presses themselves (`edge.core.registration.colours`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FitError
from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.colours import FreeLight, SlopeColours
from edge.core.registration.pose import Pose
from edge.core.registration.registrar import (
    SIDE_PX,
    PartInPose,
    PoseSearch,
    Registered,
    Registrar,
    depth_of,
    fade,
    in_pose,
    shrunk,
)

__all__ = ["LearntPose", "completed", "in_pose_of", "learn_pose"]

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_ROUNDS = 2
_SEED = 0
# A place of the bank is learnt where at least this share of the presses shows it.
_LEARNT_SHARE = 0.35
# The mean press must explain this much of the presses, else there is no relief to register by.
_LEAST_TYPICAL = 0.6
# A part that agrees this well with itself at any turn has none: real balls 0.92 and more, a gear of 12 teeth 0.41.
_ROUND, _ROUND_TURNS = 0.8, 72
# A press is recognised up to this many times the mismatch of the nominal one that agrees least, for damage adds to it:
# another part agrees by up to 0.53 on five simulated parts and a real ball.
_MISMATCH_TIMES, _LEAST_MATCH = 4.0, (0.55, 0.8)
_LEAST_SEEN = 0.3


@dataclass(frozen=True, eq=False)
class LearntPose:
    """What nominal presses teach of their pose."""

    part: PartInPose
    """What the gateway needs."""
    registered: tuple[Registered, ...]
    """Every nominal press, in the bank's pose."""
    frames: U8
    """Uint8 (n, h, w, 3), the same presses; where one has left the field it shows another press, so that the bank sees
    how much presses differ there."""


def learn_pose(frames: U8, free: U8) -> LearntPose:
    """Learn the pose from nominal presses and the free gel, uint8 (n, h, w, 3) and (h, w, 3). Errors: FitError."""
    light = FreeLight(free)
    added = [light.find_change(rgb) for rgb in frames]
    first = _first(added)
    found = [_aligned(light, added, first, colours) for colours in _both(added)]
    part, typical = max(found, key=lambda one: one[1])
    if max(_roundness(light, one) for one, _ in found) >= _ROUND:
        part, typical = _aligned(light, added, first, part.colours, is_turning=False)
    if typical < _LEAST_TYPICAL:
        raise FitError(
            f"no common relief by which presses can be registered: in the median one agrees by {typical:.2f} with the "
            f"others, at least {_LEAST_TYPICAL} is expected; check that all presses are of one part, and that its "
            "relief lies on the gel"
        )
    registered = tuple(Registrar(part).register(rgb) for rgb in frames)
    lowest = min(one.match for one in registered)
    part = replace(
        part,
        least_match=float(np.clip(1 - _MISMATCH_TIMES * (1 - lowest), *_LEAST_MATCH)),
        least_seen=max(_LEAST_SEEN, 0.9 * min(one.seen_share for one in registered)),
    )
    return LearntPose(part, registered, completed(registered))


def _both(added: Sequence[F32]) -> tuple[SlopeColours, SlopeColours]:
    """The colours of slopes and their mirror image. Errors: FitError."""
    levels = np.concatenate([shrunk(one).reshape(-1, 3) for one in added])
    try:
        colours = SlopeColours.of(levels)
    except ValueError as error:
        raise FitError(f"presses cannot be registered: {error}") from error
    return colours, colours.mirror()


def _first(added: Sequence[F32]) -> F32:
    """The press with most of its relief in the middle of the field."""
    h, w = added[0].shape[:2]
    y, x = np.mgrid[:h, :w]
    middle = np.exp(-((3 * (y - h / 2) / h) ** 2) - (3 * (x - w / 2) / w) ** 2)[..., None]
    shares = [float((one**2 * middle).sum()) / float(np.sqrt((one**2).sum()) + 1) for one in added]
    return added[int(np.argmax(shares))]


def _aligned(
    light: FreeLight, added: Sequence[F32], first: F32, colours: SlopeColours, is_turning: bool = True
) -> tuple[PartInPose, float]:
    """The mean press after some rounds, and how well a press agrees with it in the median."""
    mean, learnt, typical = first, np.ones(first.shape[:2], np.bool_), 0.0
    slopes = [colours.slopes(shrunk(one)) for one in added]
    factor = max(first.shape) / max(slopes[0].shape)
    for _ in range(_ROUNDS):
        search = PoseSearch(colours.slopes(shrunk(mean * learnt[..., None])), is_turning)
        found = [search.find(one) for one in slopes]
        typical = float(np.median([one.match for one in found]))
        poses = _in_the_middle([one.pose.scale(factor) for one in found])
        mean, learnt = _mean(added, poses, colours)
    free = light.picture(np.zeros_like(mean))
    template = light.picture(mean * learnt[..., None])
    # A round part shows other light towards the end of the field, and its colours are not turned with it.
    return PartInPose(free, template, learnt, colours, is_turning, scores_relief_to_end=is_turning), typical


def _roundness(light: FreeLight, part: PartInPose) -> float:
    """Measure how well the part agrees with itself at any turn, by these colours of slopes."""
    slopes = shrunk(part.colours.slopes(shrunk(light.find_change(part.template))), SIDE_PX // 2)
    return CoarseSearch(slopes, _ROUND_TURNS).roundness(slopes)


def _in_the_middle(poses: Sequence[Pose]) -> list[Pose]:
    """Move the poses to another pose of the bank, in which the presses' fields lie about its middle."""
    middles = np.array([(back.x_px, back.y_px) for back in (pose.inverse() for pose in poses)])
    x, y = np.median(middles, axis=0).tolist()
    return [pose.after(Pose(x, y)) for pose in poses]


def _mean(added: Sequence[F32], poses: Sequence[Pose], colours: SlopeColours) -> tuple[F32, Mask]:
    """The mean of what presses add in the bank's pose, and the places that enough of them show."""
    total = np.zeros_like(added[0])
    count = np.zeros(total.shape[:2], np.float32)
    for one, pose in zip(added, poses, strict=True):
        moved, seen = in_pose(one, pose, colours)
        total += moved * seen[..., None]
        count += seen
    mean = np.asarray(total / np.maximum(count, 1)[..., None], np.float32)
    return mean, count >= _LEARNT_SHARE * len(added)


def in_pose_of(part: PartInPose, frames: U8) -> U8:
    """Nominal presses as `LearntPose.frames` holds them, uint8 (n, h, w, 3)."""
    registrar = Registrar(part)
    return completed([registrar.register(rgb) for rgb in frames])


def completed(registered: Sequence[Registered]) -> U8:
    """The presses, uint8 (n, h, w, 3), each with its unseen places from the others in a random order.

    Neighbours are often presses of one piece, which differ less than presses do.
    """
    frames, rng = [], np.random.default_rng(_SEED)
    for one in registered:
        rgb, seen = one.rgb.astype(np.float32), one.seen.copy()
        for other in (registered[k] for k in rng.permutation(len(registered))):
            if seen.all():
                break
            weight = fade(depth_of(other.seen & ~seen))
            rgb += weight[..., None] * (other.rgb - rgb)
            # A seam is filled again by the next press: the mean press there would vary less than presses do.
            seen |= weight >= 1
        frames.append(np.rint(rgb).astype(np.uint8))
    return np.stack(frames)
