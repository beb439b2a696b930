"""Presses smoothed at the fit, as the gateway smooths each press after it."""

from functools import cache

import numpy as np
from tiny_fit import config, presses

from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.presses.preparation import prepare_as, prepare_presses
from edge.core.detector import Mode
from edge.core.imaging.smoothing import smooth
from edge.model.scorer import Scorer


@cache
def fitted(mode: Mode = "corrected") -> Fitted:
    return fit_files(presses(6), config(mode=mode), created="2026-01-01")


def test_the_gateway_scores_what_the_fit_learnt() -> None:
    """A nominal press as the camera shows it has the score of the smoothed one that the bank knows."""
    bundle = fitted().bundle()
    assert bundle.manifest.is_smoothed
    scorer, learnt = Scorer(bundle), prepare_presses(presses(6), 1.0).frames
    for raw, prepared in zip(presses(6).frames, learnt, strict=True):
        assert scorer.score(raw).anomaly_score == scorer.score_prepared(prepared).anomaly_score
    assert {frame.rgb.tobytes() for frame in bundle.golden} & {frame.tobytes() for frame in learnt}


def test_the_published_methods_learn_pictures_as_they_are() -> None:
    bundle, shown = fitted("paper").bundle(), presses(6)
    assert not bundle.manifest.is_smoothed
    assert prepare_as(bundle, shown) is shown


def test_the_raw_pictures_stay_for_damage_to_be_rendered_into() -> None:
    """Also of a choice of presses; the free gel is smoothed with them."""
    shown = presses(6, no_contact=presses(1).frames)
    kept = prepare_as(fitted().bundle(), shown).choose([4, 2])
    assert kept.raw is not None
    np.testing.assert_array_equal(kept.raw, shown.frames[[4, 2]])
    np.testing.assert_array_equal(kept.frames[1], smooth(shown.frames[2]))
    np.testing.assert_array_equal(kept.no_contact, smooth(shown.frames[0])[None])
