"""H7: equal distances: patches of constant gel, duplicated rows, equal scores.

Guards: the lowest row wins everywhere (`argmin`, ONNX TopK); InReaCh prefers its own place among equals
(`is_tie_local`); k-centre stops when every row equals a pick; AUROC gives half credit to ties. Checked by removal:
without the preference the first test finds one channel instead of 16; without the early end in `k_centre` the second
finds row 0 repeatedly.
"""

import numpy as np
from heads import fit, grid, presses_of, run_head

from calibration.metrics.summary import auroc
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.common.coreset import k_centre
from plugins.detectors.inreach import inreach
from plugins.detectors.inreach.channels import associate
from plugins.detectors.spade import spade


def test_constant_patches_keep_their_channels() -> None:
    """Four presses of sixteen equal patches: published, one mutual pair per realisation remains; ours keeps all."""
    rows = np.ones((4, 16, 3), np.float32)
    sizes = {}
    for is_local in (True, False):
        found = associate(rows, inreach.parameters(is_tie_local=is_local))
        sizes[is_local] = np.unique(found.key, return_counts=True)[1].tolist()
    assert sizes[True] == [4] * 16
    assert sizes[False] == [4]


def test_no_row_is_picked_twice() -> None:
    """Five different rows, each nine times: k-centre ends after five picks, the lowest of each."""
    points = np.tile(np.eye(5, dtype=np.float32), (9, 1))
    found = k_centre(points, 20, start=7)
    assert sorted(found.rows.tolist()) == [0, 1, 3, 4, 7]
    assert found.radius == 0


def test_duplicated_rows_change_no_score() -> None:
    """Every row of the bank twice: the graph's map is the same to the last bit."""
    p = patchcore.parameters()
    bank = fit(patchcore, p, presses_of(6), grid())
    asked = presses_of(2, 1)
    once = run_head(patchcore.head(grid(), bank, p), asked, bank)["score_map"]
    bank.arrays["bank"] = np.repeat(bank.arrays["bank"], 2, axis=0)  # type: ignore[index]
    twice = run_head(patchcore.head(grid(), bank, p), asked, bank)["score_map"]
    np.testing.assert_allclose(once, twice, rtol=1e-6)


def test_equal_presses_are_taken_in_their_order() -> None:
    """Twelve equal presses are all equally near: graph and oracle take the first ones and agree."""
    nominal = {tap: np.repeat(maps, 12, axis=0) for tap, maps in presses_of(1).items()}
    p = spade.parameters("paper")
    bank = fit(spade, p, nominal, grid())
    asked = presses_of(1, 1)
    found = run_head(spade.head(grid(), bank, p), asked, bank)
    expected = spade.reference_score(asked, grid(), bank, p)
    np.testing.assert_allclose(found["score_map"], expected.score_map, rtol=1e-4)


def test_equal_scores_say_nothing() -> None:
    """An AUROC over equal scores is one half, whatever the order of the presses."""
    scores, is_defective = np.ones(10), np.arange(10) >= 5
    assert auroc(scores, is_defective) == 0.5
    assert auroc(scores, ~is_defective) == 0.5
