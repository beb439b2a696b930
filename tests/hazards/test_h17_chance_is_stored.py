"""H17: random channels, projections and starting points make results that cannot be repeated.

Guards: random numbers enter `fit` as a Generator alone; the choices are in the bank or its facts; scoring and the graph
draw nothing. Checked by removal: with `np.random.default_rng()` instead of the argument in `patchcore._coreset` the
first test fails.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of

from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade

CASES = {
    "spade": (spade, "corrected", {"bank_mb": 0.003}, "start"),
    "fapm": (fapm, "corrected", {}, "start"),
    "inreach": (inreach, "corrected", {"most_rows": 20}, "start"),
    "patchcore": (patchcore, "corrected", {}, "start"),
    "patchcore paper": (patchcore, "paper", {"coreset_fraction": 0.3}, "starting_points"),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_seed_decides_everything(case: tuple) -> None:  # type: ignore[type-arg]
    """Equal seeds give equal banks and graphs to the byte; another seed gives another bank and start."""
    detector, mode, overrides, start = case
    p = detector.parameters(mode, **overrides)
    banks = [fit(detector, p, presses_of(12), grid(), seed) for seed in (3, 3, 4)]
    for name, array in banks[0].arrays.items():
        np.testing.assert_array_equal(array, banks[1].arrays[name])
    assert banks[0].facts == banks[1].facts
    assert detector.head(grid(), banks[0], p) == detector.head(grid(), banks[1], p)
    assert any(not np.array_equal(a, banks[2].arrays[name]) for name, a in banks[0].arrays.items())
    assert start in banks[0].facts


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_scoring_draws_nothing(case: tuple) -> None:  # type: ignore[type-arg]
    """The oracle gives the same result twice."""
    detector, mode, overrides, _ = case
    p = detector.parameters(mode, **overrides)
    bank = fit(detector, p, presses_of(12), grid())
    one, two = (detector.reference_score(presses_of(2, 1), grid(), bank, p) for _ in range(2))
    np.testing.assert_array_equal(one.score_map, two.score_map)
