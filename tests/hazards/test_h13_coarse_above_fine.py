"""H13: four coarse values repeated four times in a row fall on the rows of a cell, not on its quadrants.

Guard: `cover` in `plugins/detectors/fapm/parameters.py`, also where `fusion="quadrants"`; `rows` reproduces the
published layout. Checked by removal: with the published layout everywhere the tests fail, the heat is up
to three cells away.
"""

import numpy as np
import pytest
from heads import fit, run_head

from edge.core.detector import Grid
from plugins.detectors.fapm import fapm

TAPS = {"layer2": (2, 8, 8), "layer3": (3, 4, 4)}
AT = Grid((64, 64), TAPS, 15.77)


def heat(fusion: str | None, row: int, column: int) -> np.ndarray:
    """The hottest cells of the raw map when one coarse sub-patch is hot."""
    nominal = {tap: np.zeros((3, *shape), np.float32) for tap, shape in TAPS.items()}
    asked = {tap: np.zeros((1, *shape), np.float32) for tap, shape in TAPS.items()}
    # A 3x3 average spreads one hot cell evenly; this stencil makes the wanted one stand out.
    asked["layer3"][0, :, row, column] = 9.0
    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        if 0 <= row + dy < 4 and 0 <= column + dx < 4:
            asked["layer3"][0, :, row + dy, column + dx] = 4.0
    named = {} if fusion is None else {"fusion": fusion}
    p = fapm.parameters(layers=tuple(TAPS), pooling=3, **named)
    bank = fit(fapm, p, nominal, AT)
    raw = run_head(fapm.head(AT, bank, p), asked, bank)["raw_map"][0]
    return np.argwhere(raw > 0.999 * raw.max())


@pytest.mark.parametrize("fusion", [None, "quadrants"])
def test_one_hot_coarse_cell_heats_its_own_quadrant(fusion: str | None) -> None:
    """Any coarse cell away from the border heats exactly the four fine cells below it, as usual and where named."""
    for row in (1, 2):
        for column in (1, 2):
            expected = [[2 * row + i, 2 * column + j] for i in (0, 1) for j in (0, 1)]
            assert heat(fusion, row, column).tolist() == expected


def test_the_published_layout_heats_a_row() -> None:
    """Coarse cell (1, 1) is quadrant 3 of its cell: published, it heats fine row 3, columns 0 to 3."""
    assert heat("rows", 1, 1).tolist() == [[3, 0], [3, 1], [3, 2], [3, 3]]
