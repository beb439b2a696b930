"""H8: a channel whose members are all equal has standard deviation 0, and "closer than 5 x 0" holds for none.

Guards in `inreach/parameters.py`: a member may lie as far as most members of all channels (`is_floored`), and the
comparison is not strict. Checked by removal: with `<` instead of `<=` the first and the last test lose the
constant channels; without the stray distance the second keeps no channel.
"""

import numpy as np
from heads import fit, grid, presses_of

from plugins.detectors.inreach import inreach
from plugins.detectors.inreach.channels import Channels, prune


def channels_of(rows: np.ndarray) -> Channels:
    """One channel per patch, of all presses."""
    presses, cells = rows.shape[:2]
    patch, press = (index.ravel() for index in np.indices((cells, presses)))
    return Channels(patch, press, patch)


def test_a_constant_channel_is_kept() -> None:
    """Published, perfectly constant channels are deleted from the bank; ours keeps every member."""
    for is_floored, kept in ((True, 40), (False, 0)):
        rows = np.ones((8, 5, 3), np.float32)
        p = inreach.parameters("paper", is_floored=is_floored)
        assert len(prune(rows, channels_of(rows), p).key) == kept


def test_tight_channels_of_many_dimensions_are_kept() -> None:
    """In 64 dimensions distances to the mean hardly differ, so that 5 standard deviations of them are a tiny radius."""
    rows = np.random.default_rng(0).normal(size=(20, 30, 64)).astype(np.float32)
    share = {}
    for is_floored in (True, False):
        p = inreach.parameters("paper", is_floored=is_floored)
        share[is_floored] = len(prune(rows, channels_of(rows), p).key) / 600
    assert share[True] > 0.9
    assert share[False] < 0.1


def test_presses_that_are_all_alike_have_a_bank() -> None:
    """Eight equal presses: every patch keeps its channel, and their press scores 0."""
    nominal = {tap: np.repeat(maps, 8, axis=0) for tap, maps in presses_of(1).items()}
    p = inreach.parameters()
    bank = fit(inreach, p, nominal, grid())
    assert bank.facts["channels_kept"] == 64
    assert bank.facts["warnings"] == []
    assert inreach.reference_score(nominal, grid(), bank, p).score.max() < 1e-4
