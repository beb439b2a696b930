"""Upsampling and blur as matrices: the same numbers as the originals, in float64 and in the graph."""

import numpy as np
import pytest
import scipy
from graph_session import open_graph
from hypothesis import given
from hypothesis import strategies as st

from edge.core.detector import Grid
from plugins.detectors.common.smoothing import (
    Smoothing,
    emit_scores,
    gaussian_matrix,
    smoothing_matrix,
    upsampling_matrix,
)
from plugins.onnx_builder import Graph


@pytest.mark.parametrize(("pixels", "sigma"), [(224, 4.0), (224, 13.0), (30, 13.0), (7, 0.5), (5, 0.0)])
def test_blur_is_scipys(pixels: int, sigma: float) -> None:
    """The blur matrix equals scipy.ndimage.gaussian_filter, also where the kernel is wider than the image."""
    image = np.random.default_rng(0).normal(size=(pixels, pixels))
    matrix = gaussian_matrix(pixels, sigma)
    np.testing.assert_allclose(
        matrix @ image @ matrix.T,
        scipy.ndimage.gaussian_filter(image, sigma) if sigma else image,
        rtol=0,
        atol=1e-13,
    )


@pytest.mark.train
@pytest.mark.parametrize("kind", ["bilinear", "nearest"])
@pytest.mark.parametrize(("cells", "pixels"), [(56, 224), (28, 224), (14, 56), (7, 30), (1, 5)])
def test_upsampling_is_torchs(kind: str, cells: int, pixels: int) -> None:
    """The upsampling matrix equals torch's interpolate, bilinear (align_corners False) and nearest."""
    import torch

    image = np.random.default_rng(1).normal(size=(cells, cells))
    matrix = upsampling_matrix(cells, pixels, kind)  # type: ignore[arg-type]
    expected = torch.nn.functional.interpolate(
        torch.from_numpy(image)[None, None], size=(pixels, pixels), mode=kind
    )[0, 0].numpy()
    np.testing.assert_allclose(matrix @ image @ matrix.T, expected, rtol=0, atol=1e-12)


@given(st.integers(1, 40), st.integers(1, 90), st.floats(0, 20), st.sampled_from(["bilinear", "nearest"]))
def test_a_constant_stays_constant(cells: int, pixels: int, sigma: float, kind: str) -> None:
    """Every row of R sums to 1 and has no negative number: smoothing never leaves the range of the values."""
    matrix = smoothing_matrix(cells, pixels, sigma, kind)  # type: ignore[arg-type]
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    assert matrix.min() >= 0


def test_a_physical_blur_is_the_same_on_the_part() -> None:
    """Sigma in millimetres: at four times the resolution the blur covers four times the pixels."""
    low = Smoothing.of(Grid((64, 64), {"layer1": (1, 16, 16)}, 10.0), (16, 16), 0.25)
    high = Smoothing.of(Grid((256, 256), {"layer1": (1, 64, 64)}, 40.0), (64, 64), 0.25)
    assert (low.sigma_px, high.sigma_px) == (2.5, 10.0)


def test_the_graph_gives_the_oracles_map() -> None:
    """emit_scores: score_map and score equal float64 within 1e-6, raw_map is the input."""
    smoothing = Smoothing((5, 7), (20, 30), 2.0)
    graph = Graph("smooth")
    raw = graph.input("raw", ("n", 5, 7))
    emit_scores(graph, graph.op("Abs", raw), smoothing)
    grid = np.random.default_rng(2).random((3, 5, 7), np.float32)
    session = open_graph(graph.serialise())
    score_map, score, raw_map = session.run(["score_map", "score", "raw_map"], {"raw": grid})
    expected = smoothing.score_maps(grid.astype(np.float64))
    np.testing.assert_allclose(score_map, expected.score_map, rtol=1e-6)
    np.testing.assert_allclose(score, expected.score, rtol=1e-6)
    np.testing.assert_array_equal(raw_map, grid)
