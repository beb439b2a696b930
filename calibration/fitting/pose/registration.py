"""Learns from nominal presses how a part is found under the gel, and brings the presses to one pose.

One press is the first template; then each is found by the mean of half of the others, until their turns settle. This
is done with three first presses, and what two of them agree on is taken. Of many presses some are brought to their
common pose so, and the others are found by the mean of those. The colours of slopes come from the presses themselves
(`edge.core.registration.colours`).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from calibration.fitting.pose.completed import completed
from calibration.fitting.pose.turns import (
    MOST_SYMMETRY,
    SAME_TURN_RAD,
    agree_on_turns,
    find_symmetry,
    same_share,
)
from edge.core.arrays import F32, F64, U8, Mask
from edge.core.errors import FitError
from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.colours import FreeLight, SlopeColours, curl_share
from edge.core.registration.fine import Alignment, FineSearch
from edge.core.registration.pose import Pose, Registered
from edge.core.registration.registrar import (
    SIDE_PX,
    PartInPose,
    PoseSearch,
    Registrar,
    in_pose,
    shrunk,
)

__all__ = ["LearntPose", "in_pose_of", "keep_pose", "learn_pose"]

_MOST_ROUNDS = 8
# So many presses find the common pose, evenly spread over all: rounds take most of the time of a fit, and of six real
# and nine simulated parts, 20 to 51 presses each that lie anywhere, more presses settled no better.
_MOST_PRESSES = 36
# After this many the wrong one of two ways to read the colours is given up.
_TRIED_ROUNDS = 2
# Whether a part is round is asked after this many too: the turns of a ball settle by chance if they are given time, as
# on one of five real balls, and those of a part that has a turn are any no more after two.
_ROUND_ROUNDS = 4
# As many presses are tried as the first template: one may lead presses of a nearly round part to wrong turns.
_STARTS = 3
_SEED = 0
# A place of the bank is learnt where at least this share of the presses shows it.
_LEARNT_SHARE = 0.35
# The mean press must explain this much of the presses, else there is no relief to register by.
_LEAST_TYPICAL = 0.6
# It looks the same where its agreement falls by less than this: exact symmetries up to 0.011, nearly so from 0.021.
# Of presses of which a third or a half were turned by a wrong 120 degrees (PZ2, six draws) one falls by at most 0.027.
_ALIKE, _DOUBTED, _LOOKED_AT = 0.015, 0.03, 8
# A press is held like the others where it differs at their turn at most so many times as much as at its best one.
_AS_WELL = 1.5
# Of two ways to read the colours the worse is heard too where its presses differ at most so many times as much. By
# either a part without a turn is round: by the other one the light may decide on its turn.
_NEARLY = 2.0
# A part that agrees this well with itself at any turn may be round: real balls 0.75 and more, a gear of 12 teeth 0.41.
_ROUND, _ROUND_TURNS = 0.7, 72
# Presses that were turned together are refined in so many rounds.
_REFINED = 2
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

    @property
    def unrecognised(self) -> list[int]:
        """The nominal presses that a gateway rejects, for they show too little of the part, or none."""
        part, each = self.part, enumerate(self.registered)
        return [k for k, one in each if one.match < part.least_match or one.seen_share < part.least_seen]


def learn_pose(frames: U8, free: U8, unjudged: Mask | None = None) -> LearntPose:
    """Learn the pose from nominal presses and the free gel, uint8 (n, h, w, 3) and (h, w, 3). Errors: FitError."""
    light = FreeLight(free)
    added = [light.find_change(rgb) for rgb in frames]
    every = [shrunk(one) for one in added]
    chosen = np.linspace(0, len(every) - 1, min(len(every), _MOST_PRESSES)).round().astype(int).tolist()
    small = [every[k] for k in chosen]
    best = _align(small)
    if best.typical < _LEAST_TYPICAL:
        raise FitError(
            f"no common relief by which presses can be registered: in the median one agrees by {best.typical:.2f} with "
            f"the others, at least {_LEAST_TYPICAL} is expected; check that all presses are of one part, and that its "
            "relief lies on the gel"
        )
    bring = partial(_bring, light, added, frames, unjudged)
    part, registered, is_found = bring(_find_others(every, chosen, best.together or best))
    if best.together and is_found:
        best = best.together
    elif best.together:  # a gateway finds other turns, so a mean of presses at all of them is better
        part, registered, _ = bring(_find_others(every, chosen, best))
    lowest = min(placed.match for placed in registered)
    part = replace(
        part,
        least_match=float(np.clip(1 - _MISMATCH_TIMES * (1 - lowest), *_LEAST_MATCH)),
        least_seen=max(_LEAST_SEEN, 0.9 * min(placed.seen_share for placed in registered)),
    )
    return LearntPose(part, registered, completed(registered))


def keep_pose(part: PartInPose, frames: U8, unjudged: Mask | None = None) -> LearntPose:
    """Bring nominal presses, uint8 (n, h, w, 3), to a pose that was learnt before. unjudged: counts as not seen."""
    registered = _register(part, frames, unjudged)
    return LearntPose(part, registered, completed(registered))


def _bring(
    light: FreeLight, added: Sequence[F32], frames: U8, unjudged: Mask | None, aligned: "_Aligned"
) -> tuple[PartInPose, tuple[Registered, ...], bool]:
    """Average aligned presses and register each as a gateway does; tell whether that finds their turns again."""
    part = _average(light, added, aligned)
    registered = _register(part, frames, unjudged)
    turns_rad = np.array([placed.pose.turn_rad for placed in registered])
    return part, registered, same_share(turns_rad - aligned.turns) == 1


def _register(part: PartInPose, frames: U8, unjudged: Mask | None) -> tuple[Registered, ...]:
    registrar = Registrar(part)
    registered = tuple(registrar.register(rgb) for rgb in frames)
    return registered if unjudged is None else tuple(map(Registered.without, registered, unjudged))


def _firsts(small: Sequence[F32]) -> list[F32]:
    """Return the presses with most of their relief in the middle of the field, best first."""
    h, w = small[0].shape[:2]
    y, x = np.mgrid[:h, :w]
    middle = np.exp(-((3 * (y - h / 2) / h) ** 2) - (3 * (x - w / 2) / w) ** 2)[..., None]
    shares = [
        float((picture**2 * middle).sum()) / float(np.sqrt((picture**2).sum()) + 1) for picture in small
    ]
    return [small[k] for k in np.argsort(shares)[::-1][:_STARTS]]


@dataclass(frozen=True, eq=False)
class _Aligned:
    """Presses in their common pose."""

    poses: Sequence[Pose]
    """In pixels of the shrunk presses."""
    typical: float
    """How well a press agrees with the mean of others, in the median."""
    symmetry: int
    """As `PartInPose.symmetry`."""
    colours: SlopeColours
    is_held: bool = False
    """Whether presses of a part that repeats itself have one turn among those that look the same."""
    doubts: frozenset[int] = frozenset()
    """How often the part nearly looks the same in a full turn, as `symmetry`: presses may lie turned by so much."""
    together: "_Aligned | None" = None
    """The same presses turned together."""

    @property
    def turns(self) -> F64:
        return np.array([pose.turn_rad for pose in self.poses])


class _Alignment:
    """Brings presses to the pose of the first, round by round.

    In a round each press is found by the mean of half of the presses, without itself: a mean that holds the press
    would keep any turn that it has. Where a part looks the same at several turns, they do not settle.
    """

    def __init__(
        self, small: Sequence[F32], first: F32, colours: SlopeColours, is_turning: bool = True
    ) -> None:
        self._small, self._colours, self._is_turning = small, colours, is_turning
        self._slopes = [colours.slopes(picture) for picture in small]
        self._rng, self._rounds = np.random.default_rng(_SEED), 0
        self._turned = np.zeros(len(small))
        self._found = self._find(first, np.ones(first.shape[:2], np.bool_), range(len(small)))

    def settle(self, most_rounds: int = _MOST_ROUNDS) -> _Aligned:
        """Align until the turns settle, in so many rounds at most, those before included."""
        while self._rounds < most_rounds and not (self._rounds and same_share(self._turned) == 1):
            self._align()
        symmetry = find_symmetry(self._turned) if self._is_turning else 0
        typical = float(np.median([one.match for one in self._found]))
        return _Aligned(self._poses(), typical, symmetry, self._colours)

    def _align(self) -> None:
        poses = self._poses()
        order = self._rng.permutation(len(poses))
        for half, other in ((order[::2], order[1::2]), (order[1::2], order[::2])):
            mean = _mean([self._small[k] for k in other], [poses[k] for k in other], self._colours)
            for k, alignment in zip(half, self._find(*mean, half), strict=True):
                self._turned[k] = alignment.pose.turn_rad - poses[k].turn_rad
                self._found[k] = alignment
        self._rounds += 1

    def _poses(self) -> list[Pose]:
        """Move the poses to another pose of the bank, in which the presses' fields lie about its middle."""
        poses = [one.pose for one in self._found]
        middles = np.array([(back.x_px, back.y_px) for back in (pose.inverse() for pose in poses)])
        x, y = np.median(middles, axis=0).tolist()
        return [pose.after(Pose(x, y)) for pose in poses]

    def _find(self, mean: F32, learnt: Mask, presses: Iterable[int]) -> list[Alignment]:
        search = PoseSearch(self._colours.slopes(mean * learnt[..., None]), self._is_turning)
        return [search.find(self._slopes[k]) for k in presses]


def _find_others(every: Sequence[F32], chosen: Sequence[int], aligned: _Aligned) -> _Aligned:
    """Find the presses that were not chosen by the mean of those that were, whose poses stay."""
    poses, colours = dict(zip(chosen, aligned.poses, strict=True)), aligned.colours
    others = [k for k in range(len(every)) if k not in poses]
    if not others:
        return aligned
    mean, learnt = _mean([every[k] for k in chosen], aligned.poses, colours)
    search = PoseSearch(colours.slopes(mean * learnt[..., None]), aligned.symmetry > 0)
    poses |= {k: search.find(colours.slopes(every[k])).pose for k in others}
    return replace(aligned, poses=[poses[k] for k in range(len(every))])


def _align(small: Sequence[F32]) -> _Aligned:
    """Align presses by the colours of slopes and by their mirror image, the wrong one no longer than it may be right,
    and with other first presses where the part has a turn. Presses that hardly turn agree by both: then the mean press
    is a surface by the right one. Errors: FitError.
    """
    try:
        colours = SlopeColours.of(np.concatenate([picture.reshape(-1, 3) for picture in small]))
    except ValueError as error:
        raise FitError(f"presses cannot be registered: {error}") from error
    first, *others = _firsts(small)
    both = [_Alignment(small, first, each) for each in (colours, colours.mirror())]
    tried = [one.settle(_TRIED_ROUNDS) for one in both]
    for rounds in (_ROUND_ROUNDS, _MOST_ROUNDS):
        near = _hear(tried)
        tried = [both[k].settle(rounds) if one in near else one for k, one in enumerate(tried)]
        best = min(_hear(tried), key=lambda one: curl_share(_mean_slopes(small, one)))
        if _is_round(small, tried):
            return _Alignment(small, first, best.colours, is_turning=False).settle()
    best = _agree([best, *(_Alignment(small, one, best.colours).settle() for one in others)])
    return _agree_on_turns(small, _look_alike(small, best))


def _agree_on_turns(small: Sequence[F32], aligned: _Aligned) -> _Aligned:
    """Find turns that all presses share where the part seems to look the same at several turns, or nearly so."""
    count = _doubt(aligned) if aligned.symmetry == 1 else aligned.symmetry
    if count < 2 or aligned.is_held:
        return aligned
    mean = _mean_slopes(small, aligned)
    (step,) = PoseSearch(mean).find_at(mean, [2 * math.pi / count])
    slopes = [aligned.colours.slopes(picture) for picture in small]
    turned = agree_on_turns(slopes, aligned.poses, step.pose, count)
    if turned is None:
        return aligned
    alike = replace(aligned, poses=turned, symmetry=1, doubts=frozenset({count}))
    near = FineSearch(_mean_slopes(small, alike))
    poses = [near.align(slope, pose, _REFINED).pose for slope, pose in zip(slopes, turned, strict=True)]
    return replace(aligned, together=replace(alike, poses=poses))


def _hear(tried: Sequence[_Aligned]) -> list[_Aligned]:
    """Return those whose presses differ hardly more than the best one's."""
    best = max(one.typical for one in tried)
    return [one for one in tried if 1 - one.typical < _NEARLY * (1 - best)]


def _agree(tried: Sequence[_Aligned]) -> _Aligned:
    """Return the trial whose turns agree with most of another one; its symmetry is what their turns differ by.

    Where trials differ, the turns are in doubt, and the one whose presses agree best is taken.
    """
    pairs = [(one, one.turns - other.turns) for one in tried for other in tried if other is not one]
    best, turned = max(pairs, key=lambda pair: (same_share(pair[1]), pair[0].typical))
    steps = {find_symmetry(turns) for _, turns in pairs}
    if steps != {1}:
        best = max(tried, key=lambda one: one.typical)
    return replace(best, symmetry=find_symmetry(turned), doubts=frozenset(steps))


def _is_round(small: Sequence[F32], tried: Sequence[_Aligned]) -> bool:
    """Whether the part has no turn: it agrees with itself at any, and its presses do not settle or do not turn."""
    best, near = max(tried, key=lambda one: one.typical), _hear(tried)
    if all(one.symmetry for one in near) and float(np.ptp(best.turns)) > _STILL_RAD:
        return False
    return max(_roundness(small, one) for one in near) >= _ROUND


def _roundness(small: Sequence[F32], aligned: _Aligned) -> float:
    """Measure how well the mean press agrees with itself at any turn, by these colours of slopes."""
    slopes = shrunk(_mean_slopes(small, aligned), SIDE_PX // 2)
    return CoarseSearch(slopes, _ROUND_TURNS).roundness(slopes)


def _mean_slopes(small: Sequence[F32], aligned: _Aligned) -> F32:
    """Compute the slopes of the mean press, float32 (h, w, 2)."""
    mean, learnt = _mean(small, aligned.poses, aligned.colours)
    return aligned.colours.slopes(mean * learnt[..., None])


def _look_alike(small: Sequence[F32], aligned: _Aligned) -> _Aligned:
    """Find how often the part looks the same in a full turn: a press that is turned so far agrees hardly less.

    Where that is so of some presses alone, the turn is in doubt: what breaks the symmetry does not show in those. Of
    two turns that fit equally well the light prefers the smaller one, so turns that repeat do not show it.
    """
    search = PoseSearch(_mean_slopes(small, aligned))
    every = [aligned.colours.slopes(picture) for picture in small]
    slopes = every[:_LOOKED_AT]
    alignments = [search.find(slope) for slope in slopes]
    parts = range(MOST_SYMMETRY, 1, -1)

    def loses(press: F32, one: Alignment) -> list[float]:
        """Compute how much less a press agrees that is turned by each of these parts of a turn."""
        again = search.find_at(press, [one.pose.turn_rad + 2 * math.pi / n for n in parts])
        turned = [(each.pose.turn_rad - one.pose.turn_rad) % (2 * math.pi) for each in again]
        # Of many teeth the next one is found within the same turn, so the count tells them apart.
        return [
            one.match - each.match
            if abs(by - 2 * math.pi / n) < SAME_TURN_RAD and min(round(2 * math.pi / by), MOST_SYMMETRY) == n
            else 1.0
            for n, by, each in zip(parts, turned, again, strict=True)
        ]

    of_press = [loses(press, alignment) for press, alignment in zip(slopes, alignments, strict=True)]
    lost = dict(zip(parts, zip(*of_press, strict=True), strict=True))
    alike = next((n for n, each in lost.items() if np.median(each) < _ALIKE), 1)
    doubts = aligned.doubts | {n for n, each in lost.items() if min(each) < _DOUBTED}
    symmetry = max(aligned.symmetry, alike)
    if symmetry > 1:  # of turns that look the same all presses have the first one's, where they were held so
        held = [search.find_at(one, [0.0])[0] for one in every]
        best = [*alignments, *(search.find(one) for one in every[_LOOKED_AT:])]
        if all(1 - one.match <= _AS_WELL * (1 - other.match) for one, other in zip(held, best, strict=True)):
            aligned = replace(aligned, poses=[one.pose for one in held], is_held=True)
    return replace(aligned, symmetry=symmetry, doubts=doubts)


def _doubt(aligned: _Aligned) -> int:
    """Find how often the part nearly looks the same, beyond its symmetry; 1 where its turns are sure."""
    symmetry = aligned.symmetry
    doubts = (n for n in aligned.doubts if symmetry and n != 1 and n != symmetry and n % symmetry == 0)
    return min(doubts, default=1)


def _average(light: FreeLight, added: Sequence[F32], aligned: _Aligned) -> PartInPose:
    """Average the presses in their common pose."""
    factor = max(added[0].shape) / max(shrunk(added[0]).shape)
    mean, learnt = _mean(added, [pose.scale(factor) for pose in aligned.poses], aligned.colours)
    free = light.picture(np.zeros_like(mean))
    template = light.picture(mean * learnt[..., None])
    # A round part shows other light towards the end of the field, and its colours are not turned with it.
    return PartInPose(
        free,
        template,
        learnt,
        aligned.colours,
        aligned.symmetry,
        _doubt(aligned),
        is_held=aligned.is_held,
        scores_relief_to_end=aligned.symmetry > 0,
    )


def _mean(added: Sequence[F32], poses: Sequence[Pose], colours: SlopeColours) -> tuple[F32, Mask]:
    """The mean of what presses add in the bank's pose, and the places that enough of them show."""
    total = np.zeros_like(added[0])
    count = np.zeros(total.shape[:2], np.float32)
    for added_light, pose in zip(added, poses, strict=True):
        moved, seen = in_pose(added_light, pose, colours)
        total += cv2.copyTo(moved, seen.view(np.uint8))  # 0 elsewhere
        count += seen
    mean = np.asarray(total / np.maximum(count, 1)[..., None], np.float32)
    return mean, count >= _LEARNT_SHARE * len(added)


def in_pose_of(part: PartInPose, frames: U8) -> U8:
    """Nominal presses as `LearntPose.frames` holds them, uint8 (n, h, w, 3)."""
    registrar = Registrar(part)
    return completed([registrar.register(rgb) for rgb in frames])
