"""H5, at the fit: squares below float32's smallest number are 0, squares above its largest infinite; and one press far
stronger than the others sets the directions, prototypes and int8 steps of all.

Guard: `validation._check_strength` refuses values below 1e-15 or above 1e12, and a press 100 times as strong as usual.
Checked by removal: without the first limit a defect scores 0 at 1e-30 (SPADE, FAPM, all of `paper`) and PaDiM ends in
LinAlgError at 1e-40. Without the last, a stored bank is wrong by 6 to 79 times the peak (SPADE, FAPM, InReaCh,
PatchCore).
"""

import numpy as np
import pytest
from heads import fit, grid, presses_of, run_head, stored, with_spot

from edge.core.detector import Nominal
from edge.core.errors import FitError
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade

ALL = [padim, spade, fapm, inreach, patchcore, subspace]


@pytest.mark.parametrize("scale", [1e-40, 1e-38, 1e-30, 1e-17, 1e15, 1e30])
@pytest.mark.parametrize("mode", ["paper", "corrected"])
@pytest.mark.parametrize("detector", ALL, ids=lambda d: d.name)
def test_features_out_of_range_are_refused(detector: object, mode: str, scale: float) -> None:
    """Denormals, underflow and overflow: one sentence with the tap, its largest value and the limits."""
    p = detector.parameters(mode, **taps_of(detector, mode))  # type: ignore[attr-defined]
    with (
        np.errstate(under="ignore"),
        pytest.raises(FitError, match=r"'layer\d' of the nominal presses reaches .*float32"),
    ):
        fit(detector, p, presses_of(6, scale=scale), grid())  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1e-14, 1e-6, 1e10])
@pytest.mark.parametrize("detector", ALL, ids=lambda d: d.name)
def test_a_defect_stands_out_at_any_scale_that_is_taken(detector: object, scale: float) -> None:
    """Within the limits a spot scores above every nominal press, in the graph and with the stored bank."""
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = stored(fit(detector, p, presses_of(12, scale=scale), grid()))  # type: ignore[arg-type]
    head = detector.head(grid(), bank, p)  # type: ignore[attr-defined]
    sound = presses_of(3, 1, scale=scale)
    usual = run_head(head, sound, bank)["score"]
    assert run_head(head, with_spot(sound), bank)["score"].min() > usual.max() > 0


@pytest.mark.parametrize("times", [1e3, 1e4, 1e6])
@pytest.mark.parametrize("detector", ALL, ids=lambda d: d.name)
def test_a_nominal_press_far_stronger_than_the_others_is_named(detector: object, times: float) -> None:
    """One of twelve presses a thousand times brighter or more: refused by its number."""
    nominal = presses_of(12)
    for maps in nominal.values():
        maps[5] *= np.float32(times)
    with pytest.raises(FitError, match=r"of nominal presses \[5\] is more than 100 times as strong as usual"):
        fit(detector, detector.parameters(), nominal, grid())  # type: ignore[attr-defined, arg-type]


@pytest.mark.parametrize("detector", [spade, fapm, inreach, patchcore], ids=lambda d: d.name)
def test_a_press_thirty_times_brighter_spoils_no_stored_bank(detector: object) -> None:
    """Accepted presses do no harm: the stored bank keeps the oracle's map of sound presses within 5 %."""
    nominal, asked = presses_of(12), presses_of(2, 1)
    for maps in nominal.values():
        maps[5] *= np.float32(30)
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = fit(detector, p, nominal, grid())  # type: ignore[arg-type]
    expected = detector.reference_score(asked, grid(), bank, p).score_map  # type: ignore[attr-defined]
    kept = stored(bank)
    found = run_head(detector.head(grid(), kept, p), asked, kept)["score_map"]  # type: ignore[attr-defined]
    assert np.abs(found - expected).max() < 0.05 * expected.max()


def test_frames_of_the_free_gel_are_held_to_the_same_limits() -> None:
    """A picture of the free gel that is out of range is refused too."""
    touched = np.zeros((32, 32), bool)
    touched[8:16, 8:16] = True
    nominal = Nominal(presses_of(4), touched, presses_of(2, 3, scale=1e-30))
    with np.errstate(under="ignore"), pytest.raises(FitError, match="of the no-contact frames reaches"):
        padim.fit(nominal, grid(), padim.parameters(), np.random.default_rng(0), lambda fraction: None)


def taps_of(detector: object, mode: str) -> dict[str, object]:
    """InReaCh's published taps are a Wide-ResNet's."""
    named = {"taps": ("layer1", "layer2"), "grid_tap": "layer1"}
    return named if detector is inreach and mode == "paper" else {}
