"""How often a part looks the same in a full turn, by aligned presses; nearly so, its presses are turned together."""

import math
from collections.abc import Sequence
from dataclasses import replace

from calibration.fitting.pose.aligned import Aligned, mean_slopes
from calibration.fitting.pose.turns import MOST_SYMMETRY, SAME_TURN_RAD, agree_on_turns, find_asymmetry
from edge.core.arrays import F32
from edge.core.registration.fine import Alignment, FineSearch
from edge.core.registration.pose import Pose
from edge.core.registration.registrar import PoseSearch

__all__ = ["DOUBTED", "settle_turns"]

# It looks the same where what differs from itself turned, and no tilt or move explains, is less than this and 1/n of
# the other as a share of its relief: 24 rendered presses of parts that look the same 2, 3, 4 and 6 times have up to
# 0.0051, 12 up to 0.0079, of a pinion with a flat in its bore 0.010, of a connector with three pins 0.034.
_ALIKE, _ALIKE_OF_FEW = 0.0045, 0.06
# It does not nearly look the same where so much differs: two like bumps turned by a twelfth 0.5, a connector 0.05.
_UNLIKE = 0.2
# Of presses of which a third or a half were turned by a wrong 120 degrees (PZ2, six draws) one falls by at most 0.027.
DOUBTED, _LOOKED_AT = 0.03, 8
# A press is held like the others where it differs at their turn at most so many times as much as at its best one.
_AS_WELL = 1.5
# Presses that were turned together are refined in so many rounds.
_REFINED = 2


def settle_turns(small: Sequence[F32], aligned: Aligned) -> Aligned:
    """Find how often the part looks the same, and turn presses together where it only nearly does so.

    Between presses of a part that looks the same, tilt alone tells turns apart. Where tilt does not explain what
    differs, and no turns are clear, the part is found as if it looked the same.
    """
    aligned = _find_doubts(small, aligned)
    counts = sorted({*aligned.doubts, aligned.symmetry} - {0, 1}, reverse=True)
    nearly = int(not aligned.symmetry or 0 not in aligned.doubts)  # 0: turned by other angles
    near, clear = list[int](), None
    for count in counts:
        together, is_clear = _turn_together(small, aligned, count)
        means = [mean_slopes(small, one) for one in (aligned, together)]
        differs = max(find_asymmetry(mean, _step(mean, count), count) for mean in means)
        if differs < _ALIKE + _ALIKE_OF_FEW / len(small):
            more = min((n for n in near if n % count == 0), default=1)
            return replace(aligned, symmetry=count, nearly=nearly and more)
        if differs < _UNLIKE:
            near.append(count)
            if is_clear:
                clear = replace(together, symmetry=1, nearly=count)
                break
    if not (near and nearly and aligned.symmetry):
        return replace(aligned, nearly=nearly)
    count = clear.nearly if clear else near[0]
    return replace(aligned, symmetry=1 if aligned.is_held else count, nearly=count, together=clear)


def _turn_together(small: Sequence[F32], aligned: Aligned, count: int) -> tuple[Aligned, bool]:
    """Turn presses that are not held by the turns on which all agree best; tell whether these are clear."""
    if aligned.is_held:
        return aligned, False
    slopes = [aligned.colours.slopes(picture) for picture in small]
    step = _step(mean_slopes(small, aligned), count)
    turned, is_clear = agree_on_turns(slopes, aligned.poses, step, count)
    near = FineSearch(mean_slopes(small, replace(aligned, poses=turned)))
    poses = [near.align(slope, pose, _REFINED).pose for slope, pose in zip(slopes, turned, strict=True)]
    return replace(aligned, poses=poses), is_clear


def _step(mean: F32, count: int) -> Pose:
    """Find the pose in which the mean press looks most like itself, near such a part of a turn."""
    return PoseSearch(mean).find_at(mean, [2 * math.pi / count])[0].pose


def _find_doubts(small: Sequence[F32], aligned: Aligned) -> Aligned:
    """Find how often the part may look the same in a full turn: some press that is turned so far agrees hardly less.

    Of two turns that fit equally well the light prefers the smaller one, so turns that repeat do not show it.
    """
    search = PoseSearch(mean_slopes(small, aligned))
    slopes = [aligned.colours.slopes(picture) for picture in small]
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

    looked_at = list(zip(slopes, alignments, strict=True))[:_LOOKED_AT]
    of_press = [loses(press, alignment) for press, alignment in looked_at]
    lost = dict(zip(parts, zip(*of_press, strict=True), strict=True))
    aligned = replace(aligned, doubts=aligned.doubts | {n for n, each in lost.items() if min(each) < DOUBTED})
    # Presses of a part that may look the same have the first one's turn, where they were held so.
    if max({*aligned.doubts, aligned.symmetry}) > 1:
        held = [search.find_at(one, [0.0])[0] for one in slopes]
        pairs = zip(held, alignments, strict=True)
        if all(1 - one.match <= _AS_WELL * (1 - other.match) for one, other in pairs):
            return replace(aligned, poses=[one.pose for one in held], is_held=True)
    return aligned
