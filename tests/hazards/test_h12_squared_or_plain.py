"""H12: squared and plain distances rank single cells the same, but averages, blur and tile means of them differ.

Guard: the switch `is_squared` is part of the parameters of every method whose publication squares, recorded in the
manifest, and off by default. Checked by removal: with the root left out of `emit_group_nearest` the last test finds a
factor of 4.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head

from plugins.detectors.baselines.patchcore import patchcore
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


def test_a_plain_score_doubles_with_the_features() -> None:
    """Features times two: plain distances double, which squared ones would not."""
    for detector in (inreach, patchcore):
        p = detector.parameters(is_balanced=False)
        scores = []
        for scale in (1.0, 2.0):
            bank = fit(detector, p, presses_of(6, scale=scale), grid())
            scores.append(
                run_head(detector.head(grid(), bank, p), presses_of(1, 1, scale=scale), bank)["score"][0]
            )
        assert scores[1] == pytest.approx(2 * scores[0], rel=1e-4)
