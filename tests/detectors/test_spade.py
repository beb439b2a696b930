"""SPADE: the graph against the oracle, each repair against the published behaviour, and hard nominal sets."""

import numpy as np
import pytest
from heads import SMALL, fit, grid, parity, presses_of, run_head, stored_bytes, with_spot
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.detector import Grid
from plugins.detectors.common.distances import nearest
from plugins.detectors.spade import spade
from plugins.detectors.spade.window import Blocks, Tables, window_nearest

MODES = ("paper", "corrected")
# Three layers in few directions and of unit length, which the default does not use.
LAYERED = {"layers": tuple(SMALL), "dims": (3, 4, 5), "is_normalised": True}


@pytest.mark.parametrize("n", [1, 9])
def test_the_graph_is_the_oracle_of_layers_in_few_directions(n: int) -> None:
    """Map and score agree to 1e-5, also with fewer presses than neighbours, for several presses at once."""
    errors = parity(spade, spade.parameters(**LAYERED), presses_of(n), presses_of(3, 1), grid())[1:]
    assert max(errors) < 1e-5


def test_the_gallery_touches_the_same_places() -> None:
    """The means of a press and its mirror image are equal; the regions choose the one like the query. The mirror image
    has exactly the query's strength, so the means over the complete picture choose it."""
    left = {
        tap: maps * (np.arange(maps.shape[3]) < maps.shape[3] // 2) for tap, maps in presses_of(1).items()
    }
    asked = {tap: np.float32(1.02) * maps for tap, maps in left.items()}
    nominal = {tap: np.concatenate([maps, asked[tap][..., ::-1]]) for tap, maps in left.items()}
    found = {}
    for regions in (1, 4):
        p = spade.parameters(regions=regions, pixel_neighbours=1, is_balanced=False, packing="none")
        oracle, map_error, _ = parity(spade, p, nominal, asked, grid())
        assert map_error < 1e-5
        found[regions] = float(oracle.score[0])
    assert found[4] < 0.1 * found[1]


def test_the_window_keeps_matches_near() -> None:
    """Repair: a patch that is nominal elsewhere on the part is anomalous here; searched everywhere it is not seen."""
    nominal = presses_of(4, spread=0.02)
    moved = {tap: maps[:1].copy() for tap, maps in presses_of(1, 0, spread=0.02).items()}
    for maps in moved.values():
        maps[..., 0, 0] = maps[..., -1, -1]
    corner = {}
    for window_mm in (0.25, None):
        p = spade.parameters(window_mm=window_mm, dims=(), packing="none")
        bank = fit(spade, p, nominal, grid())
        corner[window_mm] = spade.reference_score(moved, grid(), bank, p).score_map[0, :4, :4].max()
    assert corner[0.25] > 5 * corner[None]


@pytest.mark.parametrize("presses", [1, 2])
def test_spade_pytorch_loses_the_last_columns(presses: int) -> None:
    """Published by SPADE-pytorch: of 12x12 cells, or of two presses', full chunks of 100 are searched, column by
    column. So the last columns of the last press are not searched, by the graph and the oracle alike."""
    taps = {"layer1": (5, 12, 12)}
    at = grid(taps)
    nominal = {"layer1": np.random.default_rng(0).normal(size=(presses, 5, 12, 12)).astype(np.float32)}
    p = spade.parameters("paper", layers=("layer1",), is_gallery_whole=False, sigma=0.0)
    bank = fit(spade, p, nominal, at)
    seen = np.arange(144).reshape(12, 12).T < 100 if presses == 1 else np.ones((12, 12), bool)
    raw = run_head(spade.head(at, bank, p), nominal, bank)["raw_map"]
    np.testing.assert_array_equal(raw[0] < 1e-5, seen)
    asked = presses_of(2, 5, taps)
    found = run_head(spade.head(at, bank, p), asked, bank)["score_map"]
    np.testing.assert_allclose(
        found, spade.reference_score(asked, at, bank, p).score_map, rtol=1e-4, atol=1e-6
    )


def _map(p: object, nominal: dict[str, np.ndarray], asked: dict[str, np.ndarray]) -> np.ndarray:
    bank = fit(spade, p, nominal, grid())
    return spade.reference_score(asked, grid(), bank, p).score_map[0]


def test_faint_features_are_still_told_apart() -> None:
    """Repair: with features of 1e-6 the published division by length + 1e-6 shrinks every distance; ours does not."""
    for is_relative in (True, False):
        p = spade.parameters("paper", is_floor_relative=is_relative, image_score="map")
        faint = _map(p, presses_of(5, scale=1e-6), presses_of(1, 2, scale=1e-6))
        plain = _map(p, presses_of(5), presses_of(1, 2))
        assert (np.abs(faint / plain - 1).max() < 1e-3) == is_relative


def test_the_score_comes_from_the_map() -> None:
    """Repair: a small spot raises the map's maximum far more than the mean distance to five presses."""
    taps = {"layer1": (6, 32, 32)}
    clean = presses_of(1, 3, taps, spread=0.1)
    rise = {}
    for image_score in ("map", "presses"):
        p = spade.parameters("paper", layers=("layer1",), is_normalised=False, image_score=image_score)
        bank = fit(spade, p, presses_of(8, 0, taps, spread=0.1), grid(taps))
        scores = [spade.reference_score(f, grid(taps), bank, p).score[0] for f in (clean, with_spot(clean))]
        rise[image_score] = scores[1] / scores[0]
    assert rise["map"] > 1.1 * rise["presses"]


def test_squared_distances_are_a_choice() -> None:
    """H12 for SPADE: SPADE-fast averages squared distances; the switch reproduces this and changes the score."""
    asked = presses_of(1, 3)
    scores = {}
    for is_squared in (False, True):
        p = spade.parameters("paper", is_squared=is_squared, image_neighbours=1)
        scores[is_squared] = parity(spade, p, presses_of(5), asked, grid())[0].score[0]
    assert scores[True] == pytest.approx(scores[False] ** 2, rel=1e-9)


def test_cells_are_drawn_where_they_look() -> None:
    """Repair: the cell at row 2, column 2 of stride 4 has its centre at pixel (8, 8); published, at (9.5, 9.5)."""
    taps = {"layer1": (4, 8, 8)}
    spot = with_spot(presses_of(1, 0, taps), 0.25)
    for is_sampled, place in ((True, (8, 8)), (False, (10, 10))):
        p = spade.parameters(layers=("layer1",), dims=(), is_sampled=is_sampled, sigma=1.0, sigma_unit="px")
        bank = fit(spade, p, presses_of(1, 0, taps), grid(taps))
        found = spade.reference_score(spot, grid(taps), bank, p).score_map[0]
        row, column = np.unravel_index(found.argmax(), found.shape)
        assert abs(row - place[0]) <= (not is_sampled)
        assert abs(column - place[1]) <= (not is_sampled)


@pytest.mark.parametrize("packing", ["float16", "int8"])
def test_the_bank_stays_within_its_size(packing: str) -> None:
    """Presses are left out until the bank fits, scales of int8 included; the most different stay, with a warning."""
    nominal = presses_of(20)
    p = spade.parameters(packing=packing, **LAYERED)
    room = 0.45 * stored_bytes(fit(spade, p, nominal, grid()))
    small = fit(spade, p.model_copy(update={"bank_mb": room / 1e6}), nominal, grid())
    assert 6 <= len(small.arrays["layer1_bank"]) <= 9
    assert stored_bytes(small) <= room
    assert "left out" in small.facts["warnings"][0]
    assert len(small.facts["presses"]) == len(small.arrays["layer1_bank"])


def test_small_cells_are_averaged() -> None:
    """At four times the resolution a cell is a quarter as large: 2x2 of them become one."""
    taps = {"layer1": (6, 32, 32)}
    nominal, asked = presses_of(5, 0, taps), presses_of(2, 1, taps)
    fine = Grid((128, 128), taps, 4 * 15.77)
    for cell_mm, cells in ((0.127, 16 * 16), (None, 32 * 32), (0.254, 8 * 8)):
        p = spade.parameters(cell_mm=cell_mm)
        _, map_error, _ = parity(spade, p, nominal, asked, fine)
        assert map_error < 1e-5
        assert fit(spade, p, nominal, fine).arrays["layer1_bank"].shape[1] == cells
    assert fit(spade, spade.parameters(), nominal, grid(taps)).arrays["layer1_bank"].shape[1] == 32 * 32


def test_all_dark_features_have_a_score() -> None:
    """Presses whose features are all zero have no length and no distances; a bright press still scores high."""
    dark = {tap: np.zeros_like(maps) for tap, maps in presses_of(3).items()}
    p = spade.parameters()
    bank = fit(spade, p, dark, grid())
    assert spade.reference_score(dark, grid(), bank, p).score.max() == 0
    assert spade.reference_score(presses_of(1), grid(), bank, p).score.min() > 0


@pytest.mark.parametrize("mode", MODES)
def test_the_order_of_the_bank_is_free(mode: str) -> None:
    """Permuted presses give equal scores."""
    nominal, asked = presses_of(7), presses_of(2, 1)
    p = spade.parameters(mode)
    bank = fit(spade, p, nominal, grid())
    order = np.random.default_rng(0).permutation(7)
    shuffled = fit(spade, p, nominal, grid())
    for name in ("press_descriptors", *(name for name in bank.arrays if name.endswith("_bank"))):
        shuffled.arrays[name][:] = bank.arrays[name][order]  # type: ignore[index]
    a = spade.reference_score(asked, grid(), bank, p)
    b = spade.reference_score(asked, grid(), shuffled, p)
    np.testing.assert_allclose(a.score_map, b.score_map, rtol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 15), st.integers(1, 15), st.integers(0, 4), st.integers(1, 2), st.integers(0, 1000))
def test_blocks_reach_their_windows(h: int, w: int, window: int, tiles: int, seed: int) -> None:
    """Every stored cell finds in its block exactly the stored cells of its clamped window."""
    stored = np.flatnonzero(np.random.default_rng(seed).random(tiles * h * w) < 0.7)
    blocks = Blocks((h, w), window, tiles)
    tables, bias = Tables.of(blocks, stored), blocks.bias()
    assert (tables.queries.reshape(-1)[tables.back] == stored).all()
    for cell, at in zip(stored, tables.back, strict=True):
        block, slot = divmod(int(at), tables.queries.shape[1])
        reached = tables.reached[block][bias[slot] == 0]
        first, own = divmod(int(cell), h * w)
        rows = range(max(0, own // w - window), min(h, own // w + window + 1))
        columns = range(max(0, own % w - window), min(w, own % w + window + 1))
        expected = {first * h * w + r * w + c for r in rows for c in columns} & set(stored.tolist())
        assert set(stored[reached[reached < len(stored)]].tolist()) == expected


def test_a_window_over_the_whole_map_is_the_whole_search() -> None:
    """Window equals full search once it covers the map."""
    rng = np.random.default_rng(0)
    queries, gallery = rng.normal(size=(5, 4, 3)), rng.normal(size=(2, 5, 4, 3))
    whole = nearest(queries.reshape(-1, 3), gallery.reshape(-1, 3)).distances.reshape(5, 4)
    np.testing.assert_allclose(window_nearest(queries, gallery, 4), whole, rtol=1e-12)
