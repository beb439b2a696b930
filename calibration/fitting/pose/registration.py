"""Learns from nominal presses how a part is found under the gel, and brings the presses to one pose.

One press is the first template; then each is found by the mean of half of the others, until their turns settle. This
is done with three first presses, and what two of them agree on is taken. The colours of slopes come from the presses
themselves (`edge.core.registration.colours`).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FitError
from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.colours import FreeLight, SlopeColours
from edge.core.registration.fine import Alignment
from edge.core.registration.pose import Pose, Registered
from edge.core.registration.registrar import (
    SIDE_PX,
    PartInPose,
    PoseSearch,
    Registrar,
    depth_of,
    fade,
    in_pose,
    shrunk,
)

__all__ = ["LearntPose", "completed", "in_pose_of", "learn_pose"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_MOST_ROUNDS = 8
# As many presses are tried as the first template: one may lead presses of a nearly round part to wrong turns.
_STARTS = 3
_SEED = 0
# A place of the bank is learnt where at least this share of the presses shows it.
_LEARNT_SHARE = 0.35
# The mean press must explain this much of the presses, else there is no relief to register by.
_LEAST_TYPICAL = 0.6
# A turn is the same within this angle, and a part's turns are if this share of its presses keeps them.
_SAME_TURN_RAD, _SAME_SHARE = math.radians(5), 0.9
# A part repeats itself at most so often in a turn; more teeth than that are as good as round.
_MOST_SYMMETRY = 12
# It looks the same where its agreement falls by less than this: exact symmetries up to 0.011, nearly so from 0.021.
_ALIKE, _LOOKED_AT = 0.015, 8
# Of two ways to read the colours the worse is heard too where its presses differ at most so many times as much. By
# either a part without a turn is round: by the other one the light may decide on its turn.
_NEARLY = 2.0
# A part that agrees this well with itself at any turn may be round: real balls 0.75 and more, a gear of 12 teeth 0.41.
_ROUND, _ROUND_TURNS = 0.7, 72
# Presses that turn by less than this all together do not turn.
_STILL_RAD = math.radians(45)
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
    firsts = _firsts(added)
    tried = [_align(added, firsts[0], colours) for colours in _both(added)]
    best = max(tried, key=lambda one: one.typical)
    if _is_round(added, tried):
        best = _align(added, firsts[0], best.colours, is_turning=False)
    else:
        best = _agree([best, *(_align(added, first, best.colours) for first in firsts[1:])])
        best = replace(best, symmetry=max(best.symmetry, _look_alike(added, best)))
    if best.typical < _LEAST_TYPICAL:
        raise FitError(
            f"no common relief by which presses can be registered: in the median one agrees by {best.typical:.2f} with "
            f"the others, at least {_LEAST_TYPICAL} is expected; check that all presses are of one part, and that its "
            "relief lies on the gel"
        )
    part = _average(light, added, best)
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


def _firsts(added: Sequence[F32]) -> list[F32]:
    """Return the presses with most of their relief in the middle of the field, best first."""
    h, w = added[0].shape[:2]
    y, x = np.mgrid[:h, :w]
    middle = np.exp(-((3 * (y - h / 2) / h) ** 2) - (3 * (x - w / 2) / w) ** 2)[..., None]
    shares = [float((one**2 * middle).sum()) / float(np.sqrt((one**2).sum()) + 1) for one in added]
    return [added[k] for k in np.argsort(shares)[::-1][:_STARTS]]


@dataclass(frozen=True, eq=False)
class _Aligned:
    """Presses in their common pose."""

    poses: Sequence[Pose]
    """In pixels of the presses."""
    typical: float
    """How well a press agrees with the mean of others, in the median."""
    symmetry: int
    """As `PartInPose.symmetry`."""
    colours: SlopeColours

    @property
    def turns(self) -> F64:
        return np.array([pose.turn_rad for pose in self.poses])


def _align(added: Sequence[F32], first: F32, colours: SlopeColours, is_turning: bool = True) -> _Aligned:
    """Bring presses to the pose of the first, until their turns settle.

    Round by round each press is found by the mean of half of the presses, without itself: a mean that holds the press
    would keep any turn that it has. Where a part looks the same at several turns, they do not settle.
    """
    slopes = [colours.slopes(shrunk(one)) for one in added]
    factor = max(first.shape) / max(slopes[0].shape)

    def find(mean: F32, learnt: Mask, presses: Iterable[int]) -> list[Alignment]:
        search = PoseSearch(colours.slopes(shrunk(mean * learnt[..., None])), is_turning)
        return [search.find(slopes[k]) for k in presses]

    rng, turned = np.random.default_rng(_SEED), np.zeros(len(added))
    found = find(first, np.ones(first.shape[:2], np.bool_), range(len(added)))
    for _ in range(_MOST_ROUNDS):
        poses = _in_the_middle([one.pose.scale(factor) for one in found])
        order = rng.permutation(len(added))
        for half, other in ((order[::2], order[1::2]), (order[1::2], order[::2])):
            mean = _mean([added[k] for k in other], [poses[k] for k in other], colours)
            for k, one in zip(half, find(*mean, half), strict=True):
                turned[k] = one.pose.turn_rad - poses[k].turn_rad
                found[k] = one
        if _same_share(turned) == 1:
            break
    poses = _in_the_middle([one.pose.scale(factor) for one in found])
    symmetry = _symmetry(turned) if is_turning else 0
    return _Aligned(poses, float(np.median([one.match for one in found])), symmetry, colours)


def _agree(tried: Sequence[_Aligned]) -> _Aligned:
    """Return the trial whose turns agree with most of another one; its symmetry is what their turns differ by."""
    pairs = [(one, one.turns - other.turns) for one in tried for other in tried if other is not one]
    best, turned = max(pairs, key=lambda pair: (_same_share(pair[1]), pair[0].typical))
    return replace(best, symmetry=_symmetry(turned))


def _is_round(added: Sequence[F32], tried: Sequence[_Aligned]) -> bool:
    """Whether the part has no turn: it agrees with itself at any, and its presses do not settle or do not turn."""
    best = max(tried, key=lambda one: one.typical)
    near = [one for one in tried if 1 - one.typical < _NEARLY * (1 - best.typical)]
    if all(one.symmetry for one in near) and float(np.ptp(best.turns)) > _STILL_RAD:
        return False
    return max(_roundness(added, one) for one in near) >= _ROUND


def _roundness(added: Sequence[F32], aligned: _Aligned) -> float:
    """Measure how well the mean press agrees with itself at any turn, by these colours of slopes."""
    mean, learnt = _mean(added, aligned.poses, aligned.colours)
    slopes = shrunk(aligned.colours.slopes(shrunk(mean * learnt[..., None])), SIDE_PX // 2)
    return CoarseSearch(slopes, _ROUND_TURNS).roundness(slopes)


def _look_alike(added: Sequence[F32], aligned: _Aligned) -> int:
    """Find how often the part looks the same in a full turn: a press that is turned so far agrees hardly less.

    Of two turns that fit equally well the light prefers the smaller one, so turns that repeat do not show it.
    """
    mean, learnt = _mean(added, aligned.poses, aligned.colours)
    search = PoseSearch(aligned.colours.slopes(shrunk(mean * learnt[..., None])))
    slopes = [aligned.colours.slopes(shrunk(one)) for one in added[:_LOOKED_AT]]
    found = [search.find(one) for one in slopes]

    def loses(n: int) -> float:
        """Compute how much less a press agrees that is turned by the n-th part of a turn, in the median."""
        lost = []
        for one, press in zip(found, slopes, strict=True):
            turn = one.pose.turn_rad + 2 * math.pi / n
            again = search.find(press, turn)
            is_there = abs(math.remainder(again.pose.turn_rad - turn, 2 * math.pi)) < _SAME_TURN_RAD
            lost.append(one.match - again.match if is_there else 1.0)
        return float(np.median(lost))

    return next((n for n in range(_MOST_SYMMETRY, 1, -1) if loses(n) < _ALIKE), 1)


def _symmetry(turned: F64) -> int:
    """Find how often a part repeats itself in a full turn, from turns that differ by chance; 0 if they are any."""
    return next((n for n in range(1, _MOST_SYMMETRY + 1) if _same_share(turned, n) >= _SAME_SHARE), 0)


def _same_share(turned: F64, symmetry: int = 1) -> float:
    """Compute the share of presses that are turned by the same angle, but for steps of the symmetry."""
    step = 2 * math.pi / symmetry
    apart = np.abs(np.remainder(turned[:, None] - turned + step / 2, step) - step / 2)
    return float((apart < _SAME_TURN_RAD).mean(axis=1).max())


def _average(light: FreeLight, added: Sequence[F32], aligned: _Aligned) -> PartInPose:
    """Average the presses in their common pose."""
    mean, learnt = _mean(added, aligned.poses, aligned.colours)
    free = light.picture(np.zeros_like(mean))
    template = light.picture(mean * learnt[..., None])
    # A round part shows other light towards the end of the field, and its colours are not turned with it.
    return PartInPose(
        free, template, learnt, aligned.colours, aligned.symmetry, scores_relief_to_end=aligned.symmetry > 0
    )


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
