"""A map in units of its limit: by hand, and the same in the head's graph."""

import numpy as np
import pytest
from graph_session import open_graph

from calibration.fitting.limits.appended import append, find_obstacle
from calibration.fitting.limits.map_limit import GUARD, find_contrast, make_limit, make_window, relate
from edge.core.detector import Bank
from edge.core.errors import FitError
from plugins.onnx_builder import Graph

PX = 4.0
"""Pixels per mm of these maps of 48x40."""

RNG = np.random.default_rng(0)
NOMINAL = (1 + 0.1 * RNG.random((12, 48, 40))).astype(np.float32)
WINDOW = make_window(NOMINAL, PX)
USUAL = WINDOW["limit_usual"].item()


def spot(value: float) -> np.ndarray:
    """A map of ones with one higher pixel."""
    one = np.ones((1, 48, 40), np.float32)
    one[0, 20, 20] = value
    return one


def test_the_surroundings_of_an_even_map_are_the_map() -> None:
    """Of an even map nothing stands out by more than 1, whatever its level; a pixel does, by nearly its height."""
    assert find_contrast(WINDOW, np.full((1, 48, 40), 7.0)) == pytest.approx(
        np.full((1, 48, 40), 7 / (7 + USUAL))
    )
    assert 0.95 < float(find_contrast(WINDOW, spot(2.0)).max()) / (2 / (1 + USUAL)) < 1


def test_what_is_usual_is_half_of_the_mean_nominal_map() -> None:
    assert pytest.approx(float(NOMINAL.mean()) / 2) == USUAL


def test_high_and_uneven_ground_hides_what_stands_out_of_low_ground() -> None:
    """The same step on ground four times as high stands out by less, and below zero nothing turns its sign."""
    low, high = (float(find_contrast(WINDOW, spot(2.0) + raised).max()) for raised in (0, 3))
    assert high < 0.9 * low
    assert float(find_contrast(WINDOW, spot(9.0) - 5).max()) == pytest.approx(4 / USUAL)


def test_a_window_keeps_what_is_wider_than_itself() -> None:
    """The mean of a slope is the slope, away from the border."""
    slope = np.broadcast_to(np.arange(40.0), (48, 40))[None]
    contrast = find_contrast(WINDOW, slope)
    assert contrast[0, :, 8:28] == pytest.approx((slope / (slope + USUAL))[0, :, 8:28], abs=0.02)


def test_a_press_exceeds_one_where_it_exceeds_the_limit() -> None:
    """The map is above 1 exactly where the contrast is above L."""
    maps = (1 + 0.3 * RNG.random((4, 48, 40))).astype(np.float32)
    above = find_contrast(WINDOW, maps) > 0.75
    assert np.array_equal(relate(make_limit(WINDOW, 0.75, 100.0), maps) > 1, above)
    assert above.any()
    assert not above.all()


def test_wide_damage_fails_by_the_guard() -> None:
    """An even rise has no contrast; from GUARD times the plain limit on it fails all the same."""
    limit = make_limit(WINDOW, 1.0, 2.0)
    assert float(relate(limit, np.full((1, 48, 40), 1.01 * GUARD * 2)).max()) > 1
    assert float(relate(limit, np.full((1, 48, 40), 0.99 * GUARD * 2)).max()) < 1


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


def test_the_graph_computes_the_oracle() -> None:
    """Map and score of four presses agree to float32, where the contrast rules and where the guard does."""
    limit = make_limit(WINDOW, 0.6, 1.5)
    head, bank = append(raw_head(), Bank({}), limit)
    assert bank.arrays.keys() == limit.keys()
    maps = np.concatenate([spot(1.4), spot(1.0), 4 * spot(1.2), spot(1.4) - 2])
    score_map, score = open_graph(head).run(["score_map", "score"], {"tap": maps, **bank.arrays})
    expected = relate(limit, maps)
    assert score_map == pytest.approx(expected, rel=1e-5, abs=1e-5)
    assert score == pytest.approx(expected.max(axis=(1, 2)), rel=1e-5)
    assert score[2] > score[0] > score[1]


def test_a_graph_of_an_older_opset_is_not_extended() -> None:
    """Reductions take their axes otherwise there."""
    assert not find_obstacle(raw_head())
    assert find_obstacle(raw_head(opset=13)) == "the head has opset 13, a limit needs 18"
    assert "it is no ONNX model" in find_obstacle(b"nonsense")


def test_another_bank_takes_over_the_limit() -> None:
    """A bank of a fold gets the arrays of the complete bundle; without arrays nothing changes. A detector
    with an array of that name is refused, not overwritten."""
    limit = make_limit(WINDOW, 0.3, 1.5)
    bank = Bank({"rows": np.ones((2, 2), np.float32)})
    _, limited = append(raw_head(), bank, {**limit, "rows": np.zeros(1)})
    assert limited.arrays.keys() == {"rows", *limit}
    assert append(raw_head(), bank, {"rows": np.zeros(1)}) == (raw_head(), bank)
    with pytest.raises(FitError, match="has an array 'limit_grid'"):
        append(raw_head(), Bank({"limit_grid": np.ones((1, 1), np.float32)}), limit)
