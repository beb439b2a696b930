"""H14: the two patch numbers of a match are read in the wrong order, and channels hold unrelated patches.

Guard: `is_index_right` in `plugins/detectors/inreach`. Checked by removal: with the swap left on, the
purity of channels under a shift of one cell is 0.37, and the first test fails.
"""

import numpy as np
import pytest

from plugins.detectors.inreach import inreach
from plugins.detectors.inreach.channels import associate


def shifted_presses(n: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """n presses of an 8x8 relief, each rolled by up to `most` cells. Also which relief cell each patch shows."""
    rng = np.random.default_rng(0)
    relief = rng.normal(size=(8, 8, 12))
    cell = np.arange(64).reshape(8, 8)
    rows, shown = [], []
    for _ in range(n):
        dy, dx = rng.integers(-most, most + 1, 2)
        rows.append(np.roll(relief, (dy, dx), (0, 1)).reshape(64, 12) + rng.normal(0, 0.01, (64, 12)))
        shown.append(np.roll(cell, (dy, dx), (0, 1)).ravel())
    return np.array(rows, np.float32), np.array(shown)


def purity(is_right: bool, most: int) -> float:
    """The share of channel members that show the same relief cell as their channel's first element."""
    rows, shown = shifted_presses(12, most)
    found = associate(rows, inreach.parameters(is_index_right=is_right))
    cell = shown[found.press, found.patch]
    first = np.unique(found.key, return_index=True, return_inverse=True)
    opener = cell[first[1]][first[2]]
    return float(np.mean(cell == opener))


@pytest.mark.parametrize("most", [0, 1, 3])
def test_channels_hold_one_place_of_the_part(most: int) -> None:
    """However the presses are shifted, every member of a channel shows the same place of the part: purity 1."""
    assert purity(True, most) == 1.0


def test_the_published_order_mixes_places() -> None:
    """The swap does no harm on aligned presses and destroys the channels of shifted ones."""
    assert purity(False, 0) == 1.0
    assert purity(False, 1) < 0.6
    assert purity(False, 3) < 0.5
