"""Turns of presses: how many are alike, and which they are where a part nearly looks the same at several.

Each press agrees about as well with the mean of presses at mixed turns whichever turn it has, so one by one they stay
mixed. Two presses tell more of each other, where symmetric relief and the light, which does not turn with the part, are
taken out: then the turns are chosen by which all pairs agree best, at the places that tell these turns apart.

Source: Singer 2011, "Angular synchronization by eigenvectors and semidefinite programming", the problem; it is solved
by coordinate ascent from several starts.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from edge.core.registration.pose import Pose, turn_slopes
from edge.core.registration.registrar import field_depth, shrunk

__all__ = [
    "MOST_SYMMETRY",
    "SAME_TURN_RAD",
    "agree_on_turns",
    "find_apart",
    "find_asymmetry",
    "find_symmetry",
    "same_share",
]

SAME_TURN_RAD = math.radians(5)
"""A turn is the same within this angle."""
MOST_SYMMETRY = 12
"""A part repeats itself at most so often in a turn; more teeth than that are as good as round."""

# A part's turns are the same if this share of its presses keeps them.
_SAME_SHARE = 0.9

# The presses as they lie are the first start, chance makes the others: of those at least one in five finds the right
# turns of a connector.
_SEED, _STARTS, _ROUNDS, _MOST_SWEEPS = 0, 24, 4, 30
# The longer side of the pictures that are compared.
_SIDE_PX = 40
# So many places, those of most weight, are compared.
_PLACES = 800
# A place counts at least as if it differed by this share of what places do in the median.
_LEAST_WITHIN = 0.1
# Turns of n presses are clear where pairs agree by this and 1/n of the other more: 24 of a connector by 0.58 to 0.69,
# of rendered parts with exact symmetry, whose turns the light alone tells apart, 24 by up to 0.44, 6 by up to 0.58.
_CLEAR, _CLEAR_OF_FEW = 0.45, 1.2

Choice = NDArray[np.intp]


def agree_on_turns(
    slopes: Sequence[F32], poses: Sequence[Pose], step: Pose, count: int
) -> tuple[list[Pose], bool]:
    """Return the poses, some turned by a few of `count` steps, at which all pairs of presses agree best; tell whether
    they do so clearly.

    slopes: of presses, float32 (h, w, 2). poses, step: in pixels of these; a step leads to the next turn at which the
    part nearly looks the same.
    """
    ways = [list(poses)]
    while len(ways) < count:
        ways.append([pose.after(step) for pose in ways[-1]])
    of_press = list(zip(*ways, strict=True))
    views, seen = _show(slopes, of_press)
    turns = np.array([[pose.turn_rad for pose in each] for each in of_press])
    rest = _take_out(views, seen, turns)
    n, rng = len(slopes), np.random.default_rng(_SEED)
    press, chosen, best = np.arange(n), np.zeros(n, np.intp), -math.inf
    for trial in range(_STARTS):
        taken = rng.integers(0, count, n) * (trial > 0)
        for _ in range(_ROUNDS):
            pairs = _agreement(rest, seen, _weigh(rest, seen, taken))
            taken = _ascend(pairs, taken)
        agreement = float(pairs[press[:, None], taken[:, None], press, taken].sum()) / (n * (n - 1))
        if agreement > best:
            best, chosen = agreement, taken
    chosen = (chosen - np.bincount(chosen).argmax()) % count
    return [each[k] for each, k in zip(of_press, chosen, strict=True)], best > _CLEAR + _CLEAR_OF_FEW / n


def find_asymmetry(slopes: F32, step: Pose, count: int) -> float:
    """Find what share of a part's relief differs from itself turned by `count` steps, and is no tilt or move of it.

    slopes: float32 (h, w, 2). Where presses of a part that looks the same lie turned by chance, their tilts do not
    average out: they are turned as these are most alike.
    """
    ways = [Pose()]
    while len(ways) < count:
        ways.append(ways[-1].after(step))
    mean = np.mean([turn_slopes(slopes, way) for way in ways], axis=0)
    y, x = (np.mgrid[: mean.shape[0], : mean.shape[1]] / max(mean.shape) - 0.5)[..., None]
    down, across = np.gradient(mean, axis=(0, 1))
    turned = np.stack([-mean[..., 1], mean[..., 0]], axis=-1) + max(mean.shape) * (across * y - down * x)
    explained = np.reshape([mean, mean * x, mean * y, across, down, turned], (6, -1)).T
    differs = (slopes - mean).ravel()
    rest = differs - explained @ np.linalg.lstsq(explained, differs)[0]
    return float((rest**2).sum() / max((mean**2).sum(), np.finfo(np.float32).tiny))


def _show(slopes: Sequence[F32], of_press: Sequence[Sequence[Pose]]) -> tuple[F32, F32]:
    """Show every press in each of its poses, float32 (n, count, places), and 1 where it is seen."""
    small = [shrunk(slope, _SIDE_PX) for slope in slopes]
    factor = max(small[0].shape) / max(slopes[0].shape)
    shown, seen = list[F32](), list[Mask]()
    for press_slopes, poses in zip(small, of_press, strict=True):
        for pose in (each.scale(factor) for each in poses):
            seen.append(np.repeat(field_depth(pose, press_slopes.shape[:2]) >= 1, 2))
            shown.append(turn_slopes(press_slopes, pose).ravel() * seen[-1])
    shape = len(slopes), -1, small[0].size
    return np.reshape(shown, shape), np.reshape(seen, shape).astype(np.float32)


def _take_out(views: F32, seen: F32, turns: F64) -> F32:
    """Take out of views what all show, and what changes at each place as the sine and cosine of their turns."""
    flat, weight = (one.reshape(-1, one.shape[2]) for one in (views, seen))
    angles = turns.ravel()
    terms = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    normal = (weight.T @ (terms[:, :, None] * terms[:, None]).reshape(-1, 9)).reshape(-1, 3, 3)
    shares = np.linalg.solve(normal + 1e-3 * len(terms) * np.eye(3), (flat.T @ terms)[..., None])[..., 0]
    return np.asarray((flat - terms @ shares.T) * weight, np.float32).reshape(views.shape)


def _weigh(rest: F32, seen: F32, taken: Choice) -> F32:
    """Weigh each place by how much more it differs from turn to turn than from press to press."""
    n, count, places = rest.shape
    flat, shown = rest.reshape(-1, places), seen.reshape(-1, places)
    of_turn = np.zeros((count, len(flat)), np.float32)
    turn = np.arange(count)[:, None]
    of_turn[turn, np.arange(n) * count + (taken + turn) % count] = 1
    total, number = of_turn @ flat, np.maximum(of_turn @ shown, 1)
    within = ((flat**2).sum(axis=0) - (total**2 / number).sum(axis=0)) / np.maximum(shown.sum(axis=0), 1)
    between = (total / number).var(axis=0)
    between, within = (np.repeat(one.reshape(-1, 2).sum(axis=1), 2) for one in (between, within))
    return np.asarray(
        between / (np.maximum(within, 0) + _LEAST_WITHIN * np.median(within) + 1e-9), np.float32
    )


def _agreement(rest: F32, seen: F32, weight: F32) -> F32:
    """Correlate every press at every turn with every other, float32 (n, count, n, count); 0 with itself."""
    n, count, places = rest.shape
    most = np.argsort(-weight, kind="stable")[:_PLACES]
    flat, shown = rest.reshape(-1, places)[:, most] * np.sqrt(weight[most]), seen.reshape(-1, places)[:, most]
    energy = flat**2 @ shown.T
    pairs = (flat @ flat.T / np.sqrt(np.maximum(energy * energy.T, 1e-9))).reshape(n, count, n, count)
    pairs[np.arange(n), :, np.arange(n)] = 0
    return np.asarray(pairs, np.float32)


def _ascend(pairs: F32, taken: Choice) -> Choice:
    """Give each press the turn at which it agrees best with the others, until none changes."""
    taken = taken.copy()
    for _ in range(_MOST_SWEEPS):
        before = taken.copy()
        for i in range(len(taken)):
            taken[i] = pairs[i][:, np.arange(len(taken)), taken].sum(axis=1).argmax()
        if (taken == before).all():
            break
    return taken


def find_symmetry(turned: F64) -> int:
    """Find how often a part repeats itself in a full turn, from turns that differ by chance; 0 if they are any."""
    return next((n for n in range(1, MOST_SYMMETRY + 1) if same_share(turned, n) >= _SAME_SHARE), 0)


def same_share(turned: F64, symmetry: int = 1) -> float:
    """Compute the share of presses that are turned by the same angle, but for steps of the symmetry."""
    return 1 - len(find_apart(turned, symmetry)) / len(turned)


def find_apart(turned: F64, symmetry: int = 1) -> list[int]:
    """Find the presses that are turned otherwise than most, but for steps of the symmetry."""
    step = 2 * math.pi / symmetry
    apart = np.abs(np.remainder(turned[:, None] - turned + step / 2, step) - step / 2)
    is_same = apart < SAME_TURN_RAD
    return np.flatnonzero(~is_same[is_same.sum(axis=1).argmax()]).tolist()
