"""H11: a library reduces another axis in its next version; everything still runs, and the maps are wrong.

Guard: distances computed by hand, on features with a different length for each axis, so that no other reduction gives
the same numbers. Checked by removal: with axis 1 instead of 3 in the reduction of `emit_group_nearest` SPADE fails,
with axis 1 instead of 2 in that of `HalvedBank.nearest` PatchCore and InReaCh do; with a maximum instead of the mean
where SPADE describes a press, SPADE does.
"""

import numpy as np
import pytest
from heads import fit, run_head

from edge.core.detector import Grid
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade


def test_spade_by_hand() -> None:
    """One row of two cells in two channels. Nominal (0,0) (3,4); asked (6,8) (0,1): distances 5 and 1."""
    at = Grid((1, 2), {"a": (2, 1, 2)}, 1.0)
    nominal = {"a": np.array([[[[0, 3]], [[0, 4]]]], np.float32)}
    asked = {"a": np.array([[[[6, 0]], [[8, 1]]]], np.float32)}
    p = spade.parameters("paper", layers=("a",), is_normalised=False, sigma=0.0)
    bank = fit(spade, p, nominal, at)
    found = run_head(spade.head(at, bank, p), asked, bank)
    np.testing.assert_allclose(found["score_map"], [[[5.0, 1.0]]], rtol=1e-6)
    # Means: nominal (1.5, 2), asked (3, 4.5).
    np.testing.assert_allclose(found["score"], np.hypot(1.5, 2.5), rtol=1e-6)


@pytest.mark.parametrize("detector", [patchcore, inreach], ids=lambda d: d.name)
def test_a_patch_bank_by_hand(detector: object) -> None:
    """One cell, two taps of two and one channels: 3x3 means with zeros around, so (27, 36) and 0 become (3, 4, 0)."""
    at = Grid((3, 5), {"a": (2, 1, 1), "b": (1, 1, 1)}, 1.0)
    nominal = {"a": np.zeros((1, 2, 1, 1), np.float32), "b": np.full((1, 1, 1, 1), 18, np.float32)}
    asked = {
        "a": np.array([27, 36], np.float32).reshape(1, 2, 1, 1),
        "b": np.full((1, 1, 1, 1), 18, np.float32),
    }
    names = "layers" if detector is patchcore else "taps"
    p = detector.parameters(  # type: ignore[attr-defined]
        **{names: ("a", "b")}, grid_tap="a", descriptor="means", is_balanced=False, dims=None
    )
    bank = fit(detector, p, nominal, at)  # type: ignore[arg-type]
    found = run_head(detector.head(at, bank, p), asked, bank)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found["score_map"], np.full((1, 3, 5), 5.0), rtol=1e-6)


def test_fapm_by_hand() -> None:
    """Two fine cells and one coarse: the map is the fine distance plus the coarse one, 1 + 2 and 2 + 2."""
    at = Grid((1, 2), {"a": (1, 1, 2), "b": (1, 1, 1)}, 1.0)
    nominal = {"a": np.zeros((1, 1, 1, 2), np.float32), "b": np.zeros((1, 1, 1, 1), np.float32)}
    # 3x3 means with zeros around: both fine cells see 9 + 0 = 9 -> 1, so one is raised by the other as well.
    asked = {"a": np.array([[[[9, 0]]]], np.float32), "b": np.full((1, 1, 1, 1), 18, np.float32)}
    p = fapm.parameters(layers=("a", "b"), pooling=3, banks="location", is_sampled=False, sigma=0.0)
    bank = fit(fapm, p, nominal, at)
    found = run_head(fapm.head(at, bank, p), asked, bank)
    np.testing.assert_allclose(found["score_map"], [[[3.0, 3.0]]], rtol=1e-6)
