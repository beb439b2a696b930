"""H4, searched in groups: the product form makes the shortlist and never the score.

Guards: `batched_nearest.emit_group_nearest`, `emit_closest`, `HalvedBank` and the window's search compute the nearest
distances again as sums of squared differences, and every head subtracts the bank's mean before. Checked by removal:
with the distance taken from the product the first test fails for each of the first three (the last for InReaCh and
PatchCore) and the second for the window. With the mean left in `pca.emit_rotation` the last fails for SPADE, InReaCh
and PatchCore, and for FAPM with 0.1 % of its groups' means left in.
"""

from collections.abc import Callable

import numpy as np
import pytest
from graph_session import open_graph
from heads import fit, grid, presses_of, run_head

from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.common.batched_nearest import HalvedBank, emit_closest, emit_group_nearest, emit_ranked
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade
from plugins.detectors.spade.window import Blocks, Tables, emit_window_nearest
from plugins.onnx_builder import Graph


def in_groups(graph: Graph, queries: str, bank: str, width: int) -> str:
    return emit_group_nearest(graph, queries, emit_ranked(graph, bank), width)


def closest(graph: Graph, queries: str, bank: str, width: int) -> str:
    one = graph.op("Unsqueeze", queries, graph.ints(0))
    return graph.op(
        "Unsqueeze", graph.op("Squeeze", emit_closest(graph, one, bank, width), graph.ints(0)), graph.ints(2)
    )


def halved(graph: Graph, queries: str, bank: str, width: int) -> str:
    """The three groups one after the other in one bank; another group's row is never near."""
    found = HalvedBank(graph, graph.reshape(bank, -1, width)).nearest(graph.reshape(queries, -1, width))
    return graph.reshape(found, 3, -1, 1)


def group_distances(search: Callable[..., str], queries: np.ndarray, bank: np.ndarray) -> np.ndarray:
    graph = Graph("groups")
    width = bank.shape[2]
    asked, rows = graph.input("q", ("g", "q", width)), graph.input("bank", ("g", "m", width))
    graph.output("d", search(graph, asked, rows, width), ("g", "q", 1))
    session = open_graph(graph.serialise())
    feed = {"q": queries.astype(np.float32), "bank": bank.astype(np.float32)}
    (distances,) = session.run(None, feed)
    return np.asarray(distances)[:, :, 0]


@pytest.mark.parametrize("search", [in_groups, closest, halved])
def test_a_small_distance_between_long_vectors(search: Callable[..., str]) -> None:
    """Three groups, vectors of length 100, true distance 0.01: found within a percent, never negative, never NaN."""
    rng = np.random.default_rng(0)
    bank = rng.normal(size=(3, 40, 64))
    bank *= 100 / np.linalg.norm(bank, axis=2, keepdims=True)
    step = rng.normal(size=(3, 20, 64))
    queries = bank[:, :20] + 0.01 * step / np.linalg.norm(step, axis=2, keepdims=True)
    np.testing.assert_allclose(group_distances(search, queries, bank), 0.01, rtol=1e-2)
    assert (group_distances(search, bank, bank) == 0).all()


def test_a_small_distance_within_a_window() -> None:
    """Two presses on two tiles of 6x5 cells, vectors of length 100, a gallery row 0.01 away in one of three presses:
    found within a percent, and a distance of zero is exactly zero.
    """
    rng = np.random.default_rng(0)
    blocks, width, presses = Blocks((6, 5), 1, 2), 64, 3
    cells = blocks.tiles * 30
    bank = rng.normal(size=(presses, cells, width))
    bank *= 100 / np.linalg.norm(bank, axis=2, keepdims=True)
    step = rng.normal(size=(2, cells, width))
    near = bank[[0, 2]] + 0.01 * step / np.linalg.norm(step, axis=2, keepdims=True)
    graph, tables = Graph("window"), Tables.of(blocks, np.arange(cells))
    rows, stored = graph.input("q", ("n", cells, width)), graph.input("bank", ("m", cells, width))
    values = graph.constant(tables.queries), graph.constant(tables.reached)
    gallery = graph.input("gallery", ("n", presses), "int64")
    found = emit_window_nearest(graph, rows, stored, gallery, blocks, values, (width, presses))
    graph.output("d", graph.op("Gather", found, graph.constant(tables.back), axis=1), ("n", cells))
    session = open_graph(graph.serialise())
    feed = {"bank": bank.astype(np.float32), "gallery": np.array([[1, 0, 2], [2, 1, 0]])}
    (distances,) = session.run(None, {**feed, "q": near.astype(np.float32)})
    np.testing.assert_allclose(distances, 0.01, rtol=1e-2)
    (zero,) = session.run(None, {**feed, "q": bank[[1, 0]].astype(np.float32)})
    assert (zero == 0).all()


@pytest.mark.parametrize("detector", [spade, fapm, inreach, patchcore], ids=lambda d: d.name)
def test_features_far_from_zero_score_as_near_zero(detector: object) -> None:
    """All features raised by 300, a thousand times their variation: the graph keeps the oracle's map to 0.1 %."""
    nominal, asked = _raised(presses_of(12)), _raised(presses_of(2, 1))
    switches = {"is_normalised": False} if detector is spade else {}
    p = detector.parameters(**switches)  # type: ignore[attr-defined]
    bank = fit(detector, p, nominal, grid())  # type: ignore[arg-type]
    found = run_head(detector.head(grid(), bank, p), asked, bank)["score_map"]  # type: ignore[attr-defined]
    expected = detector.reference_score(asked, grid(), bank, p).score_map  # type: ignore[attr-defined]
    assert np.abs(found - expected).max() < 1e-3 * expected.max()


def _raised(features: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {tap: maps + np.float32(300) for tap, maps in features.items()}
