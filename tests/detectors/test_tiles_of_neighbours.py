"""The nearest-neighbour methods on a mosaic of tiles: each tile as if it were alone, joined without seams."""

import numpy as np
import pytest
from heads import fit, parity, presses_of, run_head

from edge.core.detector import Features, Grid
from edge.core.imaging.tiles import tiling
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade

TILES = tiling((96, 128), 64, 32)
"""Two rows and three columns of tiles, each of 16x16 cells of layer1."""

TAPS = {"layer1": (4, 32, 48), "layer2": (6, 16, 24), "layer3": (8, 8, 12)}
GRID = Grid((96, 128), TAPS, 15.77, TILES)
CASES = {
    "spade": (spade, "corrected", {}),
    "spade of averaged cells": (
        spade,
        "corrected",
        {"cell_mm": 0.6, "layers": ("layer1", "layer2"), "dims": (3, 3)},
    ),
    "spade paper": (spade, "paper", {}),
    "fapm": (fapm, "corrected", {}),
    "fapm of two layers": (fapm, "corrected", {"layers": ("layer2", "layer3"), "pooling": 3}),
    "fapm paper": (fapm, "paper", {}),
    "inreach": (inreach, "corrected", {"position_weight": 2.0}),
    "patchcore": (patchcore, "corrected", {}),
    "patchcore paper": (patchcore, "paper", {"coreset_fraction": 0.1}),
}
EACH = pytest.mark.parametrize(("detector", "mode", "choice"), CASES.values(), ids=CASES)


@EACH
def test_the_graph_is_the_oracle_on_tiles(detector: object, mode: str, choice: dict[str, object]) -> None:
    """Map and score agree to 1e-5 on a mosaic, for two presses at once."""
    p = detector.parameters(mode, **choice)  # type: ignore[attr-defined]
    _, map_error, score_error = parity(detector, p, presses_of(6, 0, TAPS), presses_of(2, 1, TAPS), GRID)  # type: ignore[arg-type]
    assert map_error < 1e-5
    assert score_error < 1e-5


@EACH
def test_no_tile_sees_another(detector: object, mode: str, choice: dict[str, object]) -> None:
    """A defective tile changes its own part of the raw mosaic and no cell of the others."""
    settled = {  # SPADE's gallery depends on the complete press: here it holds every press, whatever the order
        "spade": {"pixel_neighbours": 6},
        "fapm": {"weighting": "none"},
    }
    p = detector.parameters(mode, **choice, **settled.get(detector.name, {}))  # type: ignore[attr-defined]
    bank = fit(detector, p, presses_of(6, 0, TAPS), GRID)  # type: ignore[arg-type]
    head = detector.head(GRID, bank, p)  # type: ignore[attr-defined]
    asked = presses_of(1, 1, TAPS)
    before, after = (run_head(head, f, bank)["raw_map"][0] for f in (asked, _foreign(asked)))
    rows, columns = before.shape[0] // 2, before.shape[1] // 3
    change = np.abs(after - before).reshape(2, rows, 3, columns).max(axis=(1, 3))
    assert change[0, 1] > 0.1 * before.max()
    assert np.delete(change.ravel(), 1).max() < 1e-5 * before.max()


def _foreign(features: Features) -> Features:
    """The same press with the middle tile of the upper row turned upside down and doubled."""
    found = {}
    for tap, maps in features.items():
        changed = maps.copy()
        rows, columns = maps.shape[2] // 2, maps.shape[3] // 3
        tile = changed[:, :, :rows, columns : 2 * columns]
        tile[:] = 2 * tile[:, :, ::-1].copy()
        found[tap] = changed
    return found
