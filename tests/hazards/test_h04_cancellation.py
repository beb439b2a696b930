"""H4: |a|^2 + |b|^2 - 2ab loses a small distance between large vectors, and can go below zero.

Guards in `common/distances.py`: both sides centred, the winners computed again as sums of squared differences. Checked
by removal: with the product form in `_exact` the first test finds 0 in place of 0.01; without centring in `nearest`,
the last fails at the largest offset.
"""

import numpy as np
import onnxruntime
import pytest

from plugins.detectors.common.distances import emit_nearest, nearest
from plugins.onnx_builder import Graph


def graph_distances(queries: np.ndarray, bank: np.ndarray) -> np.ndarray:
    """Nearest distances by the graph, both sides centred in float64 by the bank's mean, as the heads do."""
    graph = Graph("nearest")
    distances, _ = emit_nearest(
        graph, graph.input("q", ("q", bank.shape[1])), graph.input("bank", ("m", bank.shape[1]))
    )
    graph.output("d", distances, ("q", 1))
    session = onnxruntime.InferenceSession(graph.serialise(), providers=["CPUExecutionProvider"])
    centre = bank.mean(axis=0, dtype=np.float64)
    feeds = {"q": (queries - centre).astype(np.float32), "bank": (bank - centre).astype(np.float32)}
    found: np.ndarray = session.run(["d"], feeds)[0][:, 0]
    return found


def test_a_hundredth_between_vectors_of_a_thousand() -> None:
    """Features around 100 in 128 channels, true distance 0.01: found within 1 %, where the product form sees noise."""
    rng = np.random.default_rng(0)
    bank = 100 + rng.normal(size=(300, 128))
    step = rng.normal(size=(50, 128))
    queries = bank[:50] + 0.01 * step / np.linalg.norm(step, axis=1, keepdims=True)
    np.testing.assert_allclose(graph_distances(queries, bank), 0.01, rtol=1e-2)
    a, b = queries.astype(np.float32), bank[:50].astype(np.float32)
    product = (a * a).sum(1) + (b * b).sum(1) - 2 * (a * b).sum(1)
    assert np.abs(product - 1e-4).max() > 1e-2


def test_a_row_of_the_bank_is_at_zero() -> None:
    """A query equal to a row has distance exactly 0, never the root of something negative."""
    bank = (100 + np.random.default_rng(1).normal(size=(64, 32))).astype(np.float32)
    assert (graph_distances(bank, bank) == 0).all()
    assert (nearest(bank, bank).distances == 0).all()


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e9])
def test_the_oracle_is_brute_force_at_any_offset(offset: float) -> None:
    """float64 NumPy: the nearest distance is the smallest of all sums of squared differences, far from zero too."""
    rng = np.random.default_rng(2)
    bank, queries = offset + rng.normal(size=(200, 16)), offset + rng.normal(size=(40, 16))
    expected = np.sqrt(np.square(queries[:, None] - bank[None]).sum(-1)).min(axis=1)
    np.testing.assert_allclose(nearest(queries, bank).distances[:, 0], expected, rtol=1e-5)
