"""Nearest rows: exact where the product form fails, and independent of chunks and order."""

from functools import cache

import numpy as np
import onnxruntime
import pytest
from graph_session import open_graph
from hypothesis import given, settings
from hypothesis import strategies as st

from plugins.detectors.common.batched_nearest import HalvedBank
from plugins.detectors.common.distances import nearest
from plugins.onnx_builder import Graph


def brute(queries: np.ndarray, bank: np.ndarray) -> np.ndarray:
    """All distances as sums of squared differences, float64 (q, m)."""
    return np.sqrt(np.square(queries[:, None].astype(np.float64) - bank[None].astype(np.float64)).sum(-1))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 30), st.integers(1, 40), st.integers(1, 8), st.integers(1, 5),
    st.sampled_from([1e-6, 1.0, 1e6]), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_nearest_is_brute_force(q: int, m: int, c: int, k: int, scale: float, seed: int) -> None:
    """The shortlist never loses the nearest row, at any scale; k is clamped to the bank."""
    rng = np.random.default_rng(seed)
    queries, bank = rng.normal(5, 1, (q, c)) * scale, rng.normal(5, 1, (m, c)) * scale
    found = nearest(queries, bank, k)
    expected = np.sort(brute(queries, bank), axis=1)[:, :k]
    np.testing.assert_allclose(found.distances, expected, rtol=1e-9, atol=1e-9 * scale)


def test_the_lowest_row_wins_a_tie() -> None:
    """Among equal rows the first of the bank is returned."""
    bank = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    assert nearest(np.zeros((1, 2)), bank, 3).indices.tolist() == [[1, 2, 3]]


def test_an_empty_bank_is_refused() -> None:
    with pytest.raises(ValueError, match="m >= 1"):
        nearest(np.zeros((1, 2)), np.zeros((0, 2)))


@cache
def halved() -> onnxruntime.InferenceSession:
    """The nearest row of a bank in halves; one graph for all."""
    graph = Graph("halved")
    memory = HalvedBank(graph, graph.input("bank", ("m", 16)))
    graph.output("d", memory.nearest(graph.input("q", ("q", 16))), ("q",))
    return open_graph(graph.serialise())


@pytest.mark.parametrize("rows", [1, 2, 31, 64, 65, 200])
def test_a_halved_bank_is_brute_force(rows: int) -> None:
    """The nearest of any number of rows, also of fewer than a run or a half."""
    rng = np.random.default_rng(rows)
    queries, bank = rng.normal(size=(50, 16)), rng.normal(size=(rows, 16))
    feed = {"q": queries.astype(np.float32), "bank": bank.astype(np.float32)}
    np.testing.assert_allclose(halved().run(None, feed)[0], brute(queries, bank).min(axis=1), rtol=1e-5)


def test_a_halved_bank_measures_a_rival_from_each_half() -> None:
    """Two rows with products that are equal in float32, one in each half: the nearer one is found exactly."""
    far = np.random.default_rng(0).normal(size=16)
    far *= 3e3 / np.linalg.norm(far)
    nudge = np.zeros(16)
    nudge[0] = 1.0
    bank = np.random.default_rng(1).normal(size=(64, 16))
    for near, other in ((3, 40), (40, 3)):
        bank[near], bank[other] = far + 0.1 * nudge, far - 0.2 * nudge
        query = far.astype(np.float32)[None]
        (found,) = halved().run(None, {"q": query, "bank": bank.astype(np.float32)})
        expected = brute(query, bank.astype(np.float32)).min()
        np.testing.assert_allclose(found, expected, rtol=1e-6)
