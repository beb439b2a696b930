"""PatchCore and the bank of patches that it shares with InReaCh: graph against oracle, descriptor, repairs."""

import numpy as np
import pytest
from graph_session import open_graph
from heads import SMALL, fit, grid, presses_of, run_head
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.detector import Bank, Grid
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.common.descriptor import BINS, Descriptor, binned_weights
from plugins.detectors.common.patchbank import PatchBank
from plugins.detectors.common.pca import fit_rotation
from plugins.detectors.common.smoothing import upsampling_matrix
from plugins.onnx_builder import Graph

MODES = ("paper", "corrected")


def test_the_binned_descriptor_is_the_published_one() -> None:
    """Unfold, interpolate, average to 1024, concatenate, average to 1024: in the published order, at float64."""
    for taps in ({"a": (64, 5, 7), "b": (96, 3, 4)}, {"a": (20, 4, 4), "b": (200, 4, 4), "c": (17, 2, 2)}):
        features = {
            tap: np.random.default_rng(3).normal(size=(2, *shape)).astype(np.float32)
            for tap, shape in taps.items()
        }
        at = Grid((32, 32), taps, 1.0)
        descriptor = Descriptor(tuple(taps), "a", "binned", is_sampled=False)
        expected = _published(features, taps["a"][1:])
        np.testing.assert_allclose(descriptor.numpy(features, at, {}), expected, atol=1e-14)
        graph = Graph("descriptor")
        graph.output("found", descriptor.emit(graph, at, None), ("n", BINS, "cells"))
        (found,) = open_graph(graph.serialise()).run(None, features)
        np.testing.assert_allclose(found.swapaxes(1, 2), expected, atol=2e-6)


def _published(features: dict[str, np.ndarray], cells: tuple[int, int]) -> np.ndarray:
    parts = []
    for maps in features.values():
        n, c, h, w = maps.shape
        padded = np.pad(maps.astype(np.float64), ((0, 0), (0, 0), (1, 1), (1, 1)))
        windows = np.stack([padded[:, :, i : i + h, j : j + w] for i in range(3) for j in range(3)], axis=2)
        rows, columns = upsampling_matrix(h, cells[0]), upsampling_matrix(w, cells[1])
        unfolded = (rows @ windows.reshape(n, c * 9, h, w) @ columns.T).reshape(n, c * 9, -1).swapaxes(1, 2)
        parts.append(_adaptive(unfolded))
    return _adaptive(np.concatenate(parts, axis=2))


def _adaptive(x: np.ndarray) -> np.ndarray:
    """Adaptive average pooling of the last axis to 1024."""
    size = x.shape[-1]
    edges = [(b * size // BINS, -(-(b + 1) * size // BINS)) for b in range(BINS)]
    return np.stack([x[..., low:high].mean(axis=-1) for low, high in edges], axis=-1)


def test_the_closed_form_for_wide_resnet() -> None:
    """layer2: the 3x3 mean of a channel with its centre counted twice; layer3: the mean of two channels' 3x3 means."""
    fine, coarse = binned_weights(512, 2, 0), binned_weights(1024, 2, 1)
    window = np.full(9, 0.1)
    window[4] = 0.2
    np.testing.assert_allclose(fine, np.kron(np.eye(512), window), atol=1e-15)
    np.testing.assert_allclose(coarse, np.kron(np.eye(512), np.full(18, 1 / 18)), atol=1e-15)


def test_the_exact_coreset_leaves_no_patch_far() -> None:
    """Repair: over six seeds, k-centre over the descriptors leaves a smaller radius than over a random projection."""
    nominal = presses_of(12)
    radius: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(6):
        for is_exact, found in radius.items():
            p = patchcore.parameters(
                "paper", is_coreset_exact=is_exact, coreset_fraction=0.1, is_balanced=True
            )
            bank = fit(patchcore, p, nominal, grid(), seed)
            patches = p.rows.learn(nominal, grid(), np.random.default_rng(seed))[1].reshape(-1, BINS)
            found.append(
                np.linalg.norm(patches[:, None] - bank.arrays["bank"][None], axis=2).min(axis=1).max()
            )
    assert np.mean(radius[True]) < np.mean(radius[False])


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 12), st.integers(2, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_turned_descriptors_never_seem_farther(n: int, c: int, dims: int, seed: int) -> None:
    """Leading directions and the length of the rest: distances at most the true ones, equal with all."""
    rng = np.random.default_rng(seed)
    learnt, asked = rng.normal(size=(n, c)), rng.normal(size=(6, c)) * 3
    turned = fit_rotation(learnt, dims)(asked)
    true = np.linalg.norm(asked[:, None] - asked[None], axis=2)
    found = np.linalg.norm(turned[:, None] - turned[None], axis=2)
    assert (found <= true + 1e-5).all()
    if dims >= c:
        np.testing.assert_allclose(found, true, atol=1e-5)


def test_the_rest_shows_what_the_directions_hide() -> None:
    """A press that differs only outside the leading directions is still at its full distance."""
    learnt = np.zeros((20, 6))
    learnt[:, 0] = np.linspace(-1, 1, 20)
    turned = fit_rotation(learnt, 1)
    stray = np.array([[0.5, 0, 0, 2.0, 0, 0]])
    assert turned(stray)[0, 1] == pytest.approx(2.0)


def test_the_place_can_be_part_of_the_descriptor() -> None:
    """With a position weight the two added numbers are the row and column on the grid, in oracle and graph."""
    bank = PatchBank(Descriptor(("layer2", "layer3"), "layer2", "means", True), 4, True, 5.0)
    features = presses_of(2)
    arrays, rows = bank.learn(features, grid(), np.random.default_rng(0))
    np.testing.assert_allclose(rows[0, :, -2:], 5.0 * np.indices((4, 4)).reshape(2, -1).T / 4)
    whole = Bank({**arrays, "bank": rows[0]})
    graph = Graph("bank")
    graph.output("raw", bank.emit(graph, grid(), whole, False), ("n", 4, 4))
    found = run_head(graph.serialise(), features, whole)["raw"]
    np.testing.assert_allclose(found, bank.distances(features, grid(), whole.arrays, False), atol=1e-3)


def test_only_its_taps_are_read() -> None:
    """The head's inputs are the layers that it names, not every tap of the trunk."""
    p = patchcore.parameters("paper", coreset_fraction=0.5)
    assert patchcore.taps(p) == ("layer2", "layer3")
    bank = fit(patchcore, p, presses_of(3), grid())
    session = open_graph(patchcore.head(grid(), bank, p))
    assert {i.name for i in session.get_inputs()} & set(SMALL) == {"layer2", "layer3"}
