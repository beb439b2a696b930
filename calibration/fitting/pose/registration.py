"""Learns from nominal presses how a part is found under the gel, and brings the presses to one pose.

One press is the first template; then each is found by the mean of half of the others, until their turns settle. This
is done with three first presses, and what two of them agree on is taken. Of many presses some are brought to their
common pose so, and the others are found by the mean of those. The colours of slopes come from the presses themselves
(`edge.core.registration.colours`).
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calibration.fitting.pose.aligned import Aligned, mean_press, mean_slopes
from calibration.fitting.pose.completed import completed
from calibration.fitting.pose.symmetry import DOUBTED, settle_turns
from calibration.fitting.pose.turns import find_apart, find_symmetry, same_share
from edge.core.arrays import F32, U8, Mask
from edge.core.errors import FitError
from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.colours import FreeLight, SlopeColours, curl_share
from edge.core.registration.fine import Alignment
from edge.core.registration.pose import Pose, Registered
from edge.core.registration.registrar import (
    SIDE_PX,
    PartInPose,
    PoseSearch,
    Registrar,
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
# The mean press must explain this much of the presses, else there is no relief to register by.
_LEAST_TYPICAL = 0.6
# Of two ways to read the colours the worse is heard too where its presses differ at most so many times as much. By
# either a part without a turn is round: by the other one the light may decide on its turn.
_NEARLY = 2.0
# A part that agrees this well with itself at any turn may be round: real balls 0.75 and more, a gear of 12 teeth 0.41.
_ROUND, _ROUND_TURNS = 0.7, 72
# One that agrees so well is round also where its turns settle, unless presses that are not turned differ so many times
# as much: four real balls 0.90 to 0.96 and 1.2 to 2.5 times, a shaft with a flat 0.85 and 3.9, PZ2 0.81 and 1.6.
_SURELY_ROUND, _AS_WELL = 0.87, 1.5
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
    unsure: tuple[int, ...] = ()
    """The nominal presses that agree nearly as well at another turn, or are found at another one again."""

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
    part, registered, lost = bring(_find_others(every, chosen, best.together or best))
    if best.together and lost:
        # One press at a wrong turn in the bank sets the limit: of a connector 2 of 20 damaged ones failed, not 13.
        part, registered, lost = bring(_find_others(every, chosen, best))
    lowest = min(placed.match for placed in registered)
    part = replace(
        part,
        least_match=float(np.clip(1 - _MISMATCH_TIMES * (1 - lowest), *_LEAST_MATCH)),
        least_seen=max(_LEAST_SEEN, 0.9 * min(placed.seen_share for placed in registered)),
    )
    slopes = (part.colours.slopes(one) for one in every)
    unsure = sorted({*lost, *_find_unsure(part, light, slopes)})
    return LearntPose(part, registered, completed(registered), tuple(unsure))


def _find_unsure(part: PartInPose, light: FreeLight, slopes: Iterable[F32]) -> Iterator[int]:
    """Yield the presses that agree nearly as well at another turn at which the part nearly looks the same."""
    if part.nearly > 1:
        mean = part.colours.slopes(shrunk(light.find_change(part.template) * part.learnt[..., None]))
        search = PoseSearch(mean, nearly=part.nearly)
        for k, press in enumerate(slopes):
            (best, _), *others = search.rate_turns(press, search.find(press))
            if others and best - others[0][0] < DOUBTED:
                yield k


def keep_pose(part: PartInPose, frames: U8, unjudged: Mask | None = None) -> LearntPose:
    """Bring nominal presses, uint8 (n, h, w, 3), to a pose that was learnt before. unjudged: counts as not seen."""
    registered = _register(part, frames, unjudged)
    return LearntPose(part, registered, completed(registered))


def _bring(
    light: FreeLight, added: Sequence[F32], frames: U8, unjudged: Mask | None, aligned: Aligned
) -> tuple[PartInPose, tuple[Registered, ...], list[int]]:
    """Average aligned presses and register each as a gateway does; find those that this turns otherwise."""
    part = _average(light, added, aligned)
    registered = _register(part, frames, unjudged)
    turns_rad = np.array([placed.pose.turn_rad for placed in registered])
    apart = find_apart(turns_rad - aligned.turns, part.symmetry) if part.is_turning else []
    return part, registered, apart


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

    def settle(self, most_rounds: int = _MOST_ROUNDS) -> Aligned:
        """Align until the turns settle, in so many rounds at most, those before included."""
        while self._rounds < most_rounds and not (self._rounds and same_share(self._turned) == 1):
            self._align()
        symmetry = find_symmetry(self._turned) if self._is_turning else 0
        typical = float(np.median([one.match for one in self._found]))
        return Aligned(self._poses(), typical, symmetry, self._colours)

    def _align(self) -> None:
        poses = self._poses()
        order = self._rng.permutation(len(poses))
        for half, other in ((order[::2], order[1::2]), (order[1::2], order[::2])):
            mean = mean_press([self._small[k] for k in other], [poses[k] for k in other], self._colours)
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


def _find_others(every: Sequence[F32], chosen: Sequence[int], aligned: Aligned) -> Aligned:
    """Find the presses that were not chosen by the mean of those that were, whose poses stay."""
    poses, colours = dict(zip(chosen, aligned.poses, strict=True)), aligned.colours
    others = [k for k in range(len(every)) if k not in poses]
    if not others:
        return aligned
    mean, learnt = mean_press([every[k] for k in chosen], aligned.poses, colours)
    search = PoseSearch(colours.slopes(mean * learnt[..., None]), aligned.symmetry > 0)
    poses |= {k: search.find(colours.slopes(every[k])).pose for k in others}
    return replace(aligned, poses=[poses[k] for k in range(len(every))])


def _align(small: Sequence[F32]) -> Aligned:
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
        best = min(_hear(tried), key=lambda one: curl_share(mean_slopes(small, one)))
        if _is_round(small, tried):
            return _Alignment(small, first, best.colours, is_turning=False).settle()
    best = _agree([best, *(_Alignment(small, one, best.colours).settle() for one in others)])
    return settle_turns(small, best)


def _hear(tried: Sequence[Aligned]) -> list[Aligned]:
    """Return those whose presses differ hardly more than the best one's."""
    best = max(one.typical for one in tried)
    return [one for one in tried if 1 - one.typical < _NEARLY * (1 - best)]


def _agree(tried: Sequence[Aligned]) -> Aligned:
    """Return the trial whose turns agree with most of another one; its symmetry is what their turns differ by.

    Where trials differ, the turns are in doubt, and the one whose presses agree best is taken.
    """
    pairs = [(one, one.turns - other.turns) for one in tried for other in tried if other is not one]
    best, turned = max(pairs, key=lambda pair: (same_share(pair[1]), pair[0].typical))
    steps = {find_symmetry(turns) for _, turns in pairs}
    if steps != {1}:
        best = max(tried, key=lambda one: one.typical)
    return replace(best, symmetry=find_symmetry(turned), doubts=frozenset(steps))


def _is_round(small: Sequence[F32], tried: Sequence[Aligned]) -> bool:
    """Whether the part has no turn: it agrees with itself at any, and its presses do not settle or do not turn, or need
    no turn."""
    best, near = max(tried, key=lambda one: one.typical), _hear(tried)
    roundness = max(_roundness(small, one) for one in near)
    if any(not one.symmetry for one in near) or float(np.ptp(best.turns)) <= _STILL_RAD:
        return roundness >= _ROUND
    if roundness < _SURELY_ROUND:
        return False
    still = _Alignment(small, _firsts(small)[0], best.colours, is_turning=False).settle()
    return 1 - still.typical <= _AS_WELL * (1 - best.typical)


def _roundness(small: Sequence[F32], aligned: Aligned) -> float:
    """Measure how well the mean press agrees with itself at any turn, by these colours of slopes."""
    slopes = shrunk(mean_slopes(small, aligned), SIDE_PX // 2)
    return CoarseSearch(slopes, _ROUND_TURNS).roundness(slopes)


def _average(light: FreeLight, added: Sequence[F32], aligned: Aligned) -> PartInPose:
    """Average the presses in their common pose."""
    factor = max(added[0].shape) / max(shrunk(added[0]).shape)
    mean, learnt = mean_press(added, [pose.scale(factor) for pose in aligned.poses], aligned.colours)
    free = light.picture(np.zeros_like(mean))
    template = light.picture(mean * learnt[..., None])
    # A round part shows other light towards the end of the field, and its colours are not turned with it.
    return PartInPose(
        free,
        template,
        learnt,
        aligned.colours,
        aligned.symmetry,
        aligned.nearly,
        is_held=aligned.is_held,
        scores_relief_to_end=aligned.symmetry > 0,
    )


def in_pose_of(part: PartInPose, frames: U8) -> U8:
    """Nominal presses as `LearntPose.frames` holds them, uint8 (n, h, w, 3)."""
    registrar = Registrar(part)
    return completed([registrar.register(rgb) for rgb in frames])
