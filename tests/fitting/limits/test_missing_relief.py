"""Missing relief: by hand, and the same in the head's graph."""

import numpy as np
import pytest
from graph_session import open_graph

from calibration.fitting.limits.appended import append
from calibration.fitting.limits.relief_step import contact_of, find_missing, pool
from edge.core.detector import Bank
from edge.core.errors import FitError
from plugins.detectors.common.smoothing import upsampling_matrix
from plugins.onnx_builder import Graph

CELLS = (6, 5)
ROUGH, SMOOTH = (3.0, 0.0, 4.0), (3.0, 4.0, 0.0)
"""Features of touched cells; both are 5 from the free gel's zeros."""

RELIEF = {
    "relief_free": np.zeros((3, 1, 1)),
    "relief_level": np.full((1, 1), 5.0),
    "relief_weights": np.array([0.0, 0.25, -0.25])[None, :, None, None],
    "relief_middle": np.ones(1),
    "relief_weakest": np.ones((1, 1)),
    "relief_expected": np.full(CELLS, 0.1),
    "relief_rows": upsampling_matrix(6, 12, "sampled"),
    "relief_columns": upsampling_matrix(5, 10, "sampled").T,
    "relief_unit": np.full((1, 1), 7.0),
}
"""A rough cell lacks 0, a smooth one 2."""


def press(*touched: tuple[tuple[int, int], tuple[float, float, float]]) -> np.ndarray:
    """One press, free gel but for these cells: (1, 3, 6, 5)."""
    features = np.zeros((1, 3, *CELLS), np.float32)
    for (row, column), found in touched:
        features[0, :, row, column] = found
    return features


def patch(found: tuple[float, float, float], rows: int = 3) -> np.ndarray:
    """Three rows of four touched cells."""
    return press(*(((row, column), found) for row in range(rows) for column in range(4)))


def test_a_cell_touches_by_its_distance_from_the_free_gel() -> None:
    """Nothing at half of the level, half at the level, all of it from one and a half on."""
    cells = press(((0, 0), (2.5, 0, 0)), ((0, 1), ROUGH), ((0, 2), (7.5, 0, 0)), ((0, 3), (20, 0, 0)))
    assert contact_of(cells, RELIEF["relief_free"], 5.0)[0, 0] == pytest.approx([0, 0.5, 1, 1, 0])


def test_features_are_averaged_over_the_contact() -> None:
    """Free cells do not count, and a press without contact has no mean."""
    found = pool(np.concatenate([patch(ROUGH), press()]), RELIEF["relief_free"], 5.0)
    assert found.means == pytest.approx(np.array([ROUGH, (0, 0, 0)]))
    assert found.contact == pytest.approx([6, 0])


def test_a_rough_press_lacks_nothing_and_a_smooth_one_fails() -> None:
    """12 cells that touch half: 6 of contact. Smooth: 2 x 6 / (6 + 1). Rough: what is left is 11 / (60 + 1)."""
    assert find_missing(RELIEF, patch(ROUGH)) == pytest.approx([11 / 61])
    assert find_missing(RELIEF, patch(SMOOTH)) == pytest.approx([12 / 7])


def test_a_faint_press_fails() -> None:
    """Without contact eleven times the limit, with the weakest one allowed the limit."""
    assert find_missing(RELIEF, press()) == pytest.approx([11])
    assert find_missing(RELIEF, press(((0, 0), ROUGH), ((1, 1), ROUGH))) == pytest.approx([1])


def map_missing(relief: dict[str, np.ndarray], features: np.ndarray) -> np.ndarray:
    """The map as it must be, float64 (n, h, w): from nine tenths of the limit on, its peak what is missing."""
    touch = contact_of(features, relief["relief_free"], float(relief["relief_level"].item()))
    lack = np.einsum("nchw,c->nhw", features.astype(np.float64), relief["relief_weights"][0, :, 0, 0])
    lacking = np.maximum(touch * (lack + relief["relief_middle"]), 0)
    places = lacking + np.maximum(relief["relief_expected"] - touch, 0)
    shown = relief["relief_rows"] @ places @ relief["relief_columns"]
    missing = find_missing(relief, features)
    height = relief["relief_unit"].item() * missing * np.clip(10 * (missing - 0.9), 0, 1)
    return np.asarray((height / (shown.max(axis=(1, 2)) + 1e-12))[:, None, None] * shown)


def test_the_map_shows_what_is_missing_and_nothing_of_a_sound_press() -> None:
    """Its peak is the score, in the bundle's unit, and lies in the smooth half of the contact."""
    assert not map_missing(RELIEF, patch(ROUGH)).any()
    half = patch(ROUGH)
    half[0, :, :, :3] = patch(SMOOTH)[0, :, :, :3]
    [found] = map_missing(RELIEF, half)
    assert found.max() == pytest.approx(7 * find_missing(RELIEF, half)[0])
    assert np.argwhere(found == found.max())[:, 1].max() <= 4


def test_the_map_begins_below_the_limit() -> None:
    """It is the score's own height at the limit and 0 at nine tenths of it, so no score jumps."""

    def peak(missing: float) -> float:
        share = missing / (12 / 7)
        changed = {name: RELIEF[name] * share for name in ("relief_weights", "relief_middle")}
        return float(map_missing({**RELIEF, **changed}, patch(SMOOTH)).max())

    assert [peak(0.9), peak(0.95), peak(1.0), peak(2.0)] == pytest.approx([0, 7 * 0.95 / 2, 7, 14], abs=1e-6)


def own_head() -> bytes:
    """A head that reads the tap and gives half of its first channel's largest value everywhere."""
    graph = Graph("own")
    tap = graph.input("tap", ("n", 3, *CELLS))
    score = graph.op("ReduceMax", tap, graph.ints(1, 2, 3), keepdims=1)
    level = graph.op("ReduceMax", graph.op("Mul", score, graph.scalar(0.5)), graph.ints(3), keepdims=0)
    score_map = graph.op("Mul", level, graph.constant(np.ones((12, 10), np.float32)))
    graph.output("score_map", score_map, ("n", 12, 10))
    graph.output("score", graph.op("ReduceMax", score_map, graph.ints(1, 2), keepdims=0), ("n",))
    return graph.serialise()


def test_the_graph_computes_the_oracle() -> None:
    """Map and score of five presses agree to float32: the larger of the detector's own and of what is missing."""
    head, bank = append(own_head(), Bank({}), RELIEF, "tap")
    assert bank.arrays.keys() == RELIEF.keys()
    session = open_graph(head)
    presses = np.concatenate([patch(ROUGH), patch(SMOOTH), patch(SMOOTH, 5), press(((2, 2), ROUGH)), press()])
    score_map, score = session.run(["score_map", "score"], {"tap": presses, **bank.arrays})
    own = 0.5 * presses.max(axis=(1, 2, 3))
    expected = np.maximum(own[:, None, None], map_missing(RELIEF, presses))
    assert score_map == pytest.approx(expected, rel=1e-5, abs=1e-5)
    assert score == pytest.approx(expected.max(axis=(1, 2)), rel=1e-5)
    assert score[0] == pytest.approx(2)
    assert (score[1:] > 7).all()


def test_a_head_that_is_no_graph_is_refused() -> None:
    """With a sentence, not with a broken bundle."""
    with pytest.raises(FitError, match="cannot be extended by a limit"):
        append(b"nonsense", Bank({}), RELIEF, "tap")
