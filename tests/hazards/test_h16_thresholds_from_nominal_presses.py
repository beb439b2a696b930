"""H16: scores rescaled by the test set's extremes, or thresholds from presses in the bank, are too optimistic.

Guards: a press's score depends on that press and the bank alone; the threshold comes from nominal presses scored by
banks without them. Checked by removal: with scores divided by the batch's maximum in `heads` the first test fails. With
the complete bank instead of the fold's in `fit.py` the second finds a threshold near 0.
"""

import dataclasses

import numpy as np
import pytest
import tiny
from heads import fit, grid, presses_of, run_head, with_spot

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade


@pytest.mark.parametrize("mode", ["paper", "corrected"])
@pytest.mark.parametrize("detector", [spade, padim, fapm, inreach, patchcore, subspace], ids=lambda d: d.name)
def test_a_score_does_not_depend_on_the_other_presses(detector: object, mode: str) -> None:
    """Scored alone or with a press a hundred times brighter: the same map and score, in oracle and graph."""
    switches = {}
    if detector is inreach and mode == "paper":
        switches = {"taps": ("layer1", "layer2", "layer3"), "grid_tap": "layer1", "is_fallback": True}
    p = detector.parameters(mode, **switches)  # type: ignore[attr-defined]
    bank = fit(detector, p, presses_of(6), grid())  # type: ignore[arg-type]
    alone, extreme = presses_of(1, 1), with_spot(presses_of(1, 2), amount=100.0)
    both = {tap: np.concatenate([alone[tap], extreme[tap]]) for tap in alone}
    head = detector.head(grid(), bank, p)  # type: ignore[attr-defined]
    one, two = run_head(head, alone, bank), run_head(head, both, bank)
    np.testing.assert_allclose(one["score_map"][0], two["score_map"][0], rtol=1e-5)
    np.testing.assert_allclose(one["score"][0], two["score"][0], rtol=1e-5)
    answers = [detector.reference_score(f, grid(), bank, p) for f in (alone, both)]  # type: ignore[attr-defined]
    np.testing.assert_allclose(answers[0].score_map[0], answers[1].score_map[0], rtol=1e-9)


def test_the_threshold_knows_no_press_of_its_own() -> None:
    """SPADE scores its own presses 0; the threshold, from folds, is as high as the score of a new nominal press."""
    frames = tiny.presses(20)
    nominal = NominalPresses(frames, tuple(f"press {k}" for k in range(20)))
    config = FitConfig(
        part="bolt",
        position="crest",
        profile=tiny.PROFILE,
        region=tiny.REGION,
        detector=spade,
        trunk=Trunk("tiny", tiny.tiny_trunk()),
        overrides={"layers": ["layer1"], "dims": [], "is_balanced": False},
    )
    manifest = fit_files(nominal, config, created="2026-01-01").manifest
    single = fit_files(nominal, dataclasses.replace(config, threshold=1.0), created="2026-01-01").bundle()
    from edge.model.scorer import Scorer

    scorer = Scorer(single)
    own = max(scorer.score(frame).anomaly_score for frame in frames)
    fresh = np.median([scorer.score(frame).anomaly_score for frame in tiny.presses(20, seed=9)])
    assert own < 0.05 * fresh
    assert manifest.threshold.value > 0.8 * fresh
