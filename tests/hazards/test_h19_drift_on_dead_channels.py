"""H19: channels that never moved during the fit react to gel wear and ageing lights, and one division by almost zero
makes that the largest signal there is.

Guards: a tap's deviation and a cell's scale have floors (`patchbank._deviation`, `fapm._cell_weights`), so a quiet
place counts at most as much as the others. Checked by removal: with DEVIATION_FLOOR at 1e-9 the first test's score
rises thirty thousand times; with SCALE_FLOOR_QUANTILE at 0 the second's ten thousand. Drift that is real still raises
the whole map: watching it is the wear index's task (`edge/core`), not the detector's.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of

from edge.core.detector import Grid
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.patchcore import patchcore


@pytest.mark.parametrize("detector", [patchcore, inreach], ids=lambda d: d.name)
def test_a_dead_tap_is_not_amplified_without_bound(detector: object) -> None:
    """A tap constant at 1 drifts by 1 %: the score of a nominal press stays of the order that it had."""
    nominal, asked = presses_of(8), presses_of(1, 1)
    for features in (nominal, asked):
        features["layer3"] = np.ones_like(features["layer3"])  # type: ignore[index]
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = fit(detector, p, nominal, grid())  # type: ignore[arg-type]
    before = detector.reference_score(asked, grid(), bank, p).score[0]  # type: ignore[attr-defined]
    drifted = {**asked, "layer3": asked["layer3"] * np.float32(1.01)}
    after = detector.reference_score(drifted, grid(), bank, p).score[0]  # type: ignore[attr-defined]
    assert after < 3 * before


def test_quiet_cells_do_not_shout() -> None:
    """FAPM: a quarter of the cells varies ten thousand times less; a drift of all features is not loudest there."""
    taps = {"layer2": (6, 16, 16), "layer3": (8, 8, 8)}
    place = Grid((64, 64), taps, 15.77)
    rng = np.random.default_rng(0)
    nominal, asked = {}, {}
    for tap, shape in taps.items():
        noise = rng.normal(0, 0.1, (21, *shape)).astype(np.float32)
        noise[..., : shape[1] // 2, : shape[2] // 2] *= 1e-4
        nominal[tap], asked[tap] = noise[:20], noise[20:] + np.float32(0.05)
    p = fapm.parameters(layers=tuple(taps), pooling=3, is_calibrated=True, sigma=0.0)
    bank = fit(fapm, p, nominal, place)
    raw = fapm.reference_score(asked, place, bank, p).score_map[0]
    assert raw[:16, :16].max() < 2 * np.median(raw)
