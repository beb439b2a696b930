"""H19: channels that were constant in the fit react to gel wear and ageing lights, and a division by almost zero makes
this the largest signal.

Guards: a tap's deviation and a cell's scale have floors (`patchbank._deviation`, `embedding._deviation`,
`prototypes.cell_scales`), so a constant place counts at most as much as the others. SPADE divides a layer by its
nominal distance only where it has one. Checked by removal: with DEVIATION_FLOOR at 1e-9 the first test's score rises a
million times; with SCALE_FLOOR_QUANTILE at 0 the second's ten thousand. Real drift still raises the complete map: the
wear index (`edge/core`) detects it, not the detector.
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of

from edge.core.detector import Grid
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade

TWO = ("layer1", "layer3")
READ: dict[str, dict[str, object]] = {
    "patchcore": {"layers": TWO},
    "inreach": {"taps": TWO},
    "padim": {"taps": TWO},
    "subspace": {"taps": TWO, "grid_tap": "layer1"},
    "spade": {"layers": TWO, "dims": ()},
}


@pytest.mark.parametrize("detector", [patchcore, inreach, padim, subspace, spade], ids=lambda d: d.name)
def test_a_dead_tap_is_not_amplified_without_bound(detector: object) -> None:
    """A tap of ten channels, constant at 1, drifts by 1 %: each channel counts one deviation at most."""
    nominal, asked = presses_of(8), presses_of(1, 1)
    for features in (nominal, asked):
        features["layer3"] = np.ones_like(features["layer3"])  # type: ignore[index]
    p = detector.parameters(**READ[detector.name])  # type: ignore[attr-defined]
    bank = fit(detector, p, nominal, grid())  # type: ignore[arg-type]
    before = detector.reference_score(asked, grid(), bank, p).score[0]  # type: ignore[attr-defined]
    drifted = {**asked, "layer3": asked["layer3"] * np.float32(1.01)}
    after = detector.reference_score(drifted, grid(), bank, p).score[0]  # type: ignore[attr-defined]
    deviation = p.total_ridge**-0.5 if detector is padim else 1.0
    assert after < before + 1.1 * np.sqrt(10) * deviation


def test_quiet_cells_do_not_shout() -> None:
    """FAPM: a quarter of the cells varies ten thousand times less; a drift of all features is not highest there."""
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
