"""H10: a scan in chunks without the remainder ignores up to 8 % of a gallery, without an error.

Guards: searches run to the last row for every chunk size (`common/distances.py`, `Spade` and `PatchBank` with
`range(0, cells, step)`). Checked by removal: with `cells // step` full steps in `spade.head._emit_whole_search` the
second test fails on the shape; with the slice of SPADE-pytorch always on the first two fail.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.detector import Grid
from plugins.detectors.common.distances import nearest
from plugins.detectors.spade import spade


@settings(max_examples=12, deadline=None)
@given(st.integers(2, 13), st.integers(2, 13), st.integers(1, 3), st.integers(0, 1000))
def test_every_gallery_cell_is_found(h: int, w: int, n: int, seed: int) -> None:
    """Any size of gallery: each cell of a stored press finds itself, the last ones included."""
    taps = {"layer1": (4, h, w)}
    at = Grid((4 * h, 4 * w), taps, 15.77)
    nominal = presses_of(n, seed, taps)
    p = spade.parameters("paper", layers=("layer1",), is_normalised=False)
    bank = fit(spade, p, nominal, at)
    raw = run_head(spade.head(at, bank, p), nominal, bank)["raw_map"]
    assert raw.max() < 1e-4


def test_rows_searched_in_parts_are_the_same_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """14x14 cells and five presses are searched in three parts with a remainder: each has the oracle's distance."""
    taps, limit = {"layer1": (8, 14, 14)}, 80 * 5 * 14 * 14
    monkeypatch.setattr("plugins.detectors.spade.head.PRODUCT_LIMIT", limit)
    assert 14 * 14 % 80 != 0
    nominal = presses_of(5, 0, taps)
    p = spade.parameters("paper", layers=("layer1",), is_normalised=False)
    bank = fit(spade, p, nominal, grid(taps))
    asked = presses_of(1, 8, taps)
    raw = run_head(spade.head(grid(taps), bank, p), asked, bank)["raw_map"]
    rows = bank.arrays["layer1_bank"].reshape(-1, 8)
    other = asked["layer1"][0].reshape(8, -1).T - bank.arrays["layer1_mean"]
    np.testing.assert_allclose(raw.ravel(), nearest(other, rows).distances[:, 0], atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 60), st.integers(1, 70), st.integers(0, 10_000))
def test_the_oracle_does_not_depend_on_chunks(q: int, chunk: int, seed: int) -> None:
    """float64: any chunk gives the distances of one chunk."""
    rng = np.random.default_rng(seed)
    queries, bank = rng.normal(size=(q, 3)), rng.normal(size=(17, 3))
    whole, parts = nearest(queries, bank, chunk=q), nearest(queries, bank, chunk=chunk)
    np.testing.assert_allclose(whole.distances, parts.distances, rtol=1e-12)
