"""H12: squared and plain distances rank single cells the same, but averages, blur and tile means of them differ.

Guard: the switch `is_squared` is part of the parameters of every method whose publication squares, recorded in the
manifest, and off by default. Checked by removal: with the root left out of `emit_group_nearest` the last test finds a
factor of 4 for SPADE, of `emit_closest` for FAPM, of `HalvedBank.nearest` for InReaCh and PatchCore.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head

from edge.core.detector import Detector
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade


@pytest.mark.parametrize("detector", [patchcore, inreach], ids=lambda d: d.name)
def test_the_switch_squares_before_the_blur(detector: object) -> None:
    """Raw maps are squares of each other; the blurred maps are not, so the switch must be recorded."""
    found = {}
    for is_squared in (False, True):
        p = detector.parameters(is_squared=is_squared)  # type: ignore[attr-defined]
        bank = fit(detector, p, presses_of(6), grid())  # type: ignore[arg-type]
        found[is_squared] = run_head(detector.head(grid(), bank, p), presses_of(2, 1), bank)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found[True]["raw_map"], found[False]["raw_map"] ** 2, rtol=1e-5)
    gap = found[True]["score_map"] / found[False]["score_map"] ** 2
    assert np.abs(gap - 1).max() > 0.01


def test_what_each_mode_does() -> None:
    """Published: InReaCh and PatchCore squared, SPADE plain; ours: all plain."""
    assert [d.parameters("paper").is_squared for d in (spade, inreach, patchcore)] == [False, True, True]
    assert not any(d.parameters().is_squared for d in (spade, inreach, patchcore))


@pytest.mark.parametrize(
    ("detector", "p"),
    [
        (inreach, inreach.parameters(is_balanced=False)),
        (patchcore, patchcore.parameters(is_balanced=False)),
        (spade, spade.parameters("paper", is_normalised=False)),
        (fapm, fapm.parameters(weighting="none", is_calibrated=False)),
    ],
    ids=["inreach", "patchcore", "spade", "fapm"],
)
def test_a_plain_score_doubles_with_the_features(detector: Detector, p: object) -> None:
    """Features times two: plain distances double, in the score and in the map, which squared ones would not."""
    found = []
    for scale in (1.0, 2.0):
        bank = fit(detector, p, presses_of(6, scale=scale), grid())
        found.append(run_head(detector.head(grid(), bank, p), presses_of(1, 1, scale=scale), bank))
    for output in ("score", "raw_map"):
        np.testing.assert_allclose(found[1][output], 2 * found[0][output], rtol=1e-3)
