"""Judges of a bundle whose bank learnt rendered copies of its presses."""

import numpy as np
import pytest
import tiny
import turned_parts as parts
from registered_bundle import PROFILE, fitted, nominal

from calibration.experiments.detectability.judges import choose_judges
from calibration.fitting.presses.augmentation import render_copies
from calibration.fitting.presses.preparation import prepare_as
from edge.model.manifest_facts import copies_of_each

pytestmark = pytest.mark.usefixtures("other_package")


def test_a_bank_without_a_press_learns_the_copies_of_the_others() -> None:
    """It is the mean of tiny features, worked from the pictures of three presses and of their copies."""
    presses = nominal(parts.anywhere(parts.BLOCK, 4, shift_px=2.0, turn_rad=0.01)[1])
    found = fitted(presses, detector=tiny.TINY, augment="auto")
    each, prepared = copies_of_each(found.manifest.facts), prepare_as(found.bundle(), presses)
    copies, of = render_copies(prepared, each, PROFILE.pixels_per_mm, np.random.default_rng(0))

    assert each > 0
    judges, _ = choose_judges(found.bundle(), presses, 0, 1, lambda done: None)
    for press, judge in judges.items():
        learnt = np.concatenate([np.delete(prepared.frames, press, axis=0), copies[of != press]])
        bank = judge.scorer.bundle.bank["mean"]
        assert bank.mean() == pytest.approx(learnt.mean(dtype=np.float64) / 255, abs=1e-5)
