"""H9: few presses make short channels, short channels are dropped, and an empty bank fails or calls all anomalous.

Guards in `inreach/parameters.py` and `inreach/fit.py`: the minimum length follows the presses, and where still nothing
remains the bank is every patch, with a warning in the bundle. Checked by removal: without `_fallback` the first two
tests find a bank of no rows.
"""

import numpy as np
import pytest
from heads import fit, grid, parity, presses_of

from edge.core.errors import FitError
from plugins.detectors.inreach import inreach


def test_one_press_is_its_own_bank() -> None:
    """N = 1 has no channels: the bank is its patches, with a warning, and the map is finite."""
    p = inreach.parameters()
    bank = fit(inreach, p, presses_of(1), grid())
    assert len(bank.arrays["bank"]) == 64
    assert "every patch" in bank.facts["warnings"][0]
    oracle, map_error, _ = parity(inreach, p, presses_of(1), presses_of(2, 1), grid())
    assert np.isfinite(oracle.score_map).all()
    assert map_error < 1e-5


@pytest.mark.parametrize("n", [2, 3])
def test_the_published_rule_refuses_few_presses(n: int) -> None:
    """Without the fallback an empty bank is an error that names the cause."""
    p = inreach.parameters("paper", taps=("layer1", "layer2", "layer3"), grid_tap="layer1")
    with pytest.raises(FitError, match=f"{n} presses has 4 elements"):
        fit(inreach, p, presses_of(n), grid())


@pytest.mark.parametrize("n", [2, 3, 5, 9])
def test_fewer_presses_than_realisations(n: int) -> None:
    """N < 10 opens channels from as many presses as there are; the relative length keeps them."""
    bank = fit(inreach, inreach.parameters(), presses_of(n, spread=0.05), grid())
    assert bank.facts["realisations"] == n
    assert bank.facts["channels_kept"] > 0
    assert bank.facts["warnings"] == []
