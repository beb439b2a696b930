"""Where on the gel the limit is higher, on maps of parts that lie anywhere on a gel with a cut."""

from dataclasses import replace

import numpy as np

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.limits.gel_limits import LimitsChosen, choose_limits, learn_gel_limits
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses, ShownPresses
from calibration.fitting.limits.limit_choice import Evidence
from calibration.fitting.limits.map_limit import relate
from edge.core.registration.pose import Pose, PoseUncertainty, Registered, warp
from plugins.onnx_builder import Graph

PX, SIDE, PRESSES = 8.0, 64, 30
DAMAGE = 9.0
CUT = slice(20, 23), slice(44, 47)
"""Of the gel; three in ten presses open it."""


def head() -> bytes:
    graph = Graph("raw")
    score_map = graph.op("Mul", graph.input("tap", ("n", SIDE, SIDE)), graph.scalar(1.0))
    graph.output("score_map", score_map, ("n", SIDE, SIDE))
    graph.output("score", graph.op("ReduceMax", score_map, graph.ints(1, 2), keepdims=0), ("n",))
    return graph.serialise()


def posed(count: int, rng: np.random.Generator) -> list[Registered]:
    """Presses of a part that lies up to 10 pixels off."""
    unsure, rgb, all_seen = (
        PoseUncertainty(0, 0, None),
        np.zeros((SIDE, SIDE, 3), np.uint8),
        np.ones((SIDE, SIDE)),
    )
    poses = [Pose(float(x), float(y)) for x, y in rng.integers(-10, 11, (count, 2))]
    return [Registered(rgb, warp(all_seen, pose) > 0.5, pose, unsure, 1.0, 1.0, 0) for pose in poses]


def sound_maps(poses: list[Registered], rng: np.random.Generator, is_cut: bool) -> np.ndarray:
    """Maps in the bank's pose."""
    lying = 3 + rng.random((len(poses), SIDE, SIDE))
    if is_cut:
        opens = rng.random(len(poses)) < 0.3
        lying[opens, *CUT] += rng.uniform(10, 20, (int(opens.sum()), 1, 1))
    return np.stack([warp(m.astype(np.float32), one.pose) for m, one in zip(lying, poses, strict=True)])


def scored(maps: np.ndarray, poses: list[Registered]) -> ScoredPresses:
    whole = ScoredPresses(maps, np.zeros(len(maps)), seen=np.stack([one.seen for one in poses]))
    return replace(whole, scores=whole.highest(maps))


def chosen(seed: int, is_cut: bool = True) -> LimitsChosen:
    """The choice of a fit to these presses, each with damage in the middle of the part."""
    rng = np.random.default_rng(seed)
    poses = posed(PRESSES, rng)
    maps = sound_maps(poses, rng, is_cut)
    masks = np.zeros(maps.shape, np.bool_)
    masks[:, 40:43, 30:33] = True
    masks &= np.stack([one.seen for one in poses])
    of, frames = np.arange(PRESSES), np.zeros((PRESSES, 1, 1, 3), np.uint8)
    evidence = Evidence(
        HeldOut(scored(maps, poses), scored(np.where(masks, DAMAGE, maps).astype(np.float32), poses)),
        scored(0.9 * maps, poses),
        None,
        DamagedPresses(frames, of, masks),
        [np.arange(k, PRESSES, 5) for k in range(5)],
        (None,) * PRESSES,
        0.05,
        PX,
    )
    shown = ShownPresses({}, poses)
    return choose_limits(evidence, shown, shown, head())


def test_a_cut_of_the_gel_does_not_rule_the_limit_of_parts_anywhere() -> None:
    """Damage below the cut's scores is found, and the limit is higher at the cut alone."""
    found = chosen(0)
    assert found.gel_limits is not None
    assert found.gel_limits[CUT].min() > 2
    assert np.median(found.gel_limits) == 1
    assert found.share_found > 0.9
    assert found.evidence.scores.max() < DAMAGE


def test_a_gel_without_cuts_has_one_limit() -> None:
    assert chosen(0, is_cut=False).gel_limits is None


def test_new_sound_presses_fail_no_more_than_promised() -> None:
    """Over 20 fits to presses on the cut gel at most 5 % of new presses fail, as the gateway scores them."""
    rates = []
    for seed in range(20):
        found = chosen(seed)
        rng = np.random.default_rng(1000 + seed)
        poses = posed(40, rng)
        if found.gel_limits is not None:
            limits = [np.maximum(warp(found.gel_limits, one.pose), 1) for one in poses]
            poses = [replace(one, gel_limits=of) for one, of in zip(poses, limits, strict=True)]
        assert found.choice.other is not None
        maps = relate(found.choice.other.limit, sound_maps(poses, rng, is_cut=True)).astype(np.float32)
        rates.append(np.mean([one.score(m) > 1 for one, m in zip(poses, maps, strict=True)]))
    assert 0 < np.mean(rates) <= 0.05


def usual_maps(count: int) -> np.ndarray:
    """Maps that are highest where the part lies."""
    maps = np.full((count, SIDE, SIDE), 0.5, np.float32)
    maps[:, SIDE // 2, SIDE // 2] = 1
    return maps


def test_one_dirty_press_raises_no_limit() -> None:
    """Dust in one press is no cut of the gel; on a cut it raises the limit to twice what others show."""
    maps = usual_maps(12)
    maps[0, 30, 54] = 60
    maps[0, 3, 50] = 60  # at the rim of the view
    assert learn_gel_limits(maps, PX, 12).max() == 1
    maps[1, 30, 54] = 4
    limits = learn_gel_limits(maps, PX, 12)
    assert 4 < limits.max() < 10


def test_at_the_rim_of_the_view_all_presses_are_judged_alike() -> None:
    """Parts that end in the view score high there, each at another place."""
    maps = usual_maps(12)
    for k in range(3):
        maps[k, 2, 20 * k + 4] = 3
    limits = learn_gel_limits(maps, PX, 12)
    assert limits[:8].min() > 2
    assert limits[8:-8, 8:-8].max() == 1


def test_of_many_presses_a_few_odd_ones_raise_no_limit() -> None:
    """One more press in forty may lie high anywhere."""
    maps = usual_maps(80)
    for k in range(5):
        maps[k, 8 * k + 16, 16] = 9
    assert learn_gel_limits(maps, PX, 80).max() == 1
    maps[:4, 30, 54] = 9
    assert learn_gel_limits(maps, PX, 80)[30, 54] > 1


def test_limits_without_some_presses_are_not_more_generous() -> None:
    """Forty presses pass two over; the 32 that judge a fold do so too, for the next press is judged by forty."""
    maps = usual_maps(40)
    maps[:3, 30, 54] = 9
    assert learn_gel_limits(maps, PX, 40)[30, 54] > 1
    assert learn_gel_limits(maps[1:33], PX, 40).max() == 1
    assert learn_gel_limits(maps[:1], PX, 40).shape == (SIDE, SIDE)  # the other presses are of one piece
