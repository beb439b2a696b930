"""A map in units of its limit: by hand, and the same in the head's graph."""

import numpy as np
import onnxruntime as ort
import pytest

from calibration.fitting.limits.appended import append, can_extend
from calibration.fitting.limits.map_limit import GUARD, PLACES, SURROUNDINGS, Limit, learn_spread, relate
from edge.core.detector import Bank
from edge.core.errors import FitError
from plugins.onnx_builder import Graph

PX = 4.0
"""Pixels per mm of these maps of 48x40."""

RNG = np.random.default_rng(0)
NOMINAL = (1 + 0.1 * RNG.random((12, 48, 40))).astype(np.float32)


def spot(value: float) -> np.ndarray:
    """A map of ones with one higher pixel."""
    one = np.ones((1, 48, 40), np.float32)
    one[0, 20, 20] = value
    return one


def test_the_surroundings_of_an_even_map_are_the_map() -> None:
    """Nothing stands out of an even map, whatever its level, and a single pixel stands out by nearly its height."""
    spread = learn_spread(SURROUNDINGS, NOMINAL, PX)
    assert spread.standardise(7 * np.ones((1, 48, 40))) == pytest.approx(np.zeros((1, 48, 40)), abs=1e-9)
    assert 0.9 < float(spread.standardise(spot(2.0)).max()) < 1


def test_a_window_keeps_what_is_wider_than_itself() -> None:
    """The mean of a slope is the slope, away from the border."""
    slope = np.broadcast_to(np.arange(40.0), (48, 40))[None]
    contrast = learn_spread(SURROUNDINGS, NOMINAL, PX).standardise(slope)
    assert contrast[0, :, 8:32] == pytest.approx(np.zeros((48, 24)), abs=0.05)


def test_a_press_exceeds_one_where_it_exceeds_the_limit() -> None:
    """By place: the map is above 1 exactly where the standardised map is above L, and 1 where it equals L."""
    spread = learn_spread(PLACES, NOMINAL, PX)
    limit = spread.limit(3.0, 100.0)
    maps = (1 + 0.3 * RNG.random((4, 48, 40))).astype(np.float32)
    assert np.array_equal(relate(limit, maps) > 1, spread.standardise(maps) > 3)
    assert (spread.standardise(maps) > 3).any()
    assert not (spread.standardise(maps) > 3).all()


def test_a_place_that_is_lively_on_every_press_has_a_higher_limit() -> None:
    """A place that varies between nominal presses allows more than a quiet one."""
    lively = NOMINAL.copy()
    lively[:, 10:30, 10:30] += RNG.normal(0, 2, (12, 1, 1)).astype(np.float32)
    limit = learn_spread(PLACES, lively, PX).limit(3.0, 100.0)
    limits = 1 / relate(limit, np.ones((1, 48, 40)))[0]
    assert limits[20, 20] > 2 * limits[44, 2]


def test_a_quiet_place_has_the_median_spread() -> None:
    """A place that never varies does not fail at the first noise."""
    still = NOMINAL.copy()
    still[:, :12] = 1
    spread = learn_spread(PLACES, still, PX)
    assert spread.spread.min() >= 0.5 * np.median(spread.spread)
    assert float(spread.standardise(still + np.float32(0.01)).max()) < 20


def test_wide_damage_fails_by_the_guard() -> None:
    """An even rise has no contrast; from GUARD times the plain limit on it fails all the same."""
    limit = learn_spread(SURROUNDINGS, NOMINAL, PX).limit(0.5, 2.0)
    assert float(relate(limit, np.full((1, 48, 40), 1.01 * GUARD * 2)).max()) > 1
    assert float(relate(limit, np.full((1, 48, 40), 0.99 * GUARD * 2)).max()) < 1


@pytest.mark.parametrize("limits", [(0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0)])
def test_limits_are_positive(limits: tuple[float, float]) -> None:
    """Units of a limit of 0 or less have no meaning."""
    with pytest.raises(ValueError, match="limits are positive"):
        learn_spread(SURROUNDINGS, NOMINAL, PX).limit(*limits)


def raw_head(opset: int = 18) -> bytes:
    """A head whose map is its input."""
    graph = Graph("raw")
    given = graph.input("tap", ("n", 48, 40))
    score_map = graph.op("Mul", given, graph.scalar(1.0))
    graph.output("score_map", score_map, ("n", 48, 40))
    graph.output("score", graph.op("ReduceMax", score_map, graph.ints(1, 2), keepdims=0), ("n",))
    head = graph.serialise()
    return (
        head if opset == 18 else head.replace(bytes([66, 4, 10, 0, 16, 18]), bytes([66, 4, 10, 0, 16, opset]))
    )


def both() -> Limit:
    """A limit by place of what exceeds the surroundings, as earlier fits made it."""
    window = learn_spread(SURROUNDINGS, NOMINAL, PX).limit(0.3, 1.5)
    return {**window, **learn_spread(PLACES, NOMINAL, PX).limit(0.3, 1.5)}


@pytest.mark.parametrize("kind", [PLACES, SURROUNDINGS, "both"])
def test_the_graph_computes_the_oracle(kind: str) -> None:
    """Map and score of three presses agree to float32, where the contrast rules and where the guard does."""
    limit = both() if kind == "both" else learn_spread(kind, NOMINAL, PX).limit(0.3, 1.5)
    head, bank = append(raw_head(), Bank({}), limit)
    assert bank.arrays.keys() == limit.keys()
    maps = np.concatenate([spot(1.4), spot(1.0), 4 * spot(1.2)])
    score_map, score = ort.InferenceSession(head).run(["score_map", "score"], {"tap": maps, **bank.arrays})
    expected = relate(limit, maps)
    assert score_map == pytest.approx(expected, rel=1e-5, abs=1e-5)
    assert score == pytest.approx(expected.max(axis=(1, 2)), rel=1e-5)
    assert score[2] > score[0] > score[1]


def test_a_graph_of_an_older_opset_is_not_extended() -> None:
    """Reductions take their axes otherwise there."""
    assert can_extend(raw_head())
    assert not can_extend(raw_head(opset=13))
    assert not can_extend(b"nonsense")


def test_another_bank_takes_over_the_limit() -> None:
    """A bank of a fold gets the arrays of the complete bundle; without arrays nothing changes. A detector
    with an array of that name is refused, not overwritten."""
    limit = learn_spread(SURROUNDINGS, NOMINAL, PX).limit(0.3, 1.5)
    bank = Bank({"rows": np.ones((2, 2), np.float32)})
    _, limited = append(raw_head(), bank, {**limit, "rows": np.zeros(1)})
    assert limited.arrays.keys() == {"rows", *limit}
    assert append(raw_head(), bank, {"rows": np.zeros(1)}) == (raw_head(), bank)
    with pytest.raises(FitError, match="has an array 'limit_grid'"):
        append(raw_head(), Bank({"limit_grid": np.ones((1, 1), np.float32)}), limit)
