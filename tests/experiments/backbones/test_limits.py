"""Measures at the fitted limit, on maps and scores whose shares are known."""

import numpy as np
import pytest

from calibration.experiments.backbones.evaluation import evaluate, is_on_damage, limit_columns, random_trunk
from calibration.experiments.backbones.sets import EvaluationSet, Trial
from calibration.fitting.presses.nominal_presses import NominalPresses


def known() -> Trial:
    """Two sound presses, three damaged ones, two of another object, one under another light."""
    masks = np.zeros((8, 32, 32), np.bool_)
    masks[2:5, 10:14, 10:14] = True
    kind = np.repeat([0, 1, 2], [5, 2, 1])
    nominal = NominalPresses(np.zeros((4, 32, 32, 3), np.uint8), tuple("abcd"))
    return Trial(
        "known",
        nominal,
        np.zeros((8, 32, 32, 3), np.uint8),
        masks,
        is_other=kind == 1,
        is_relit=kind == 2,
        alpha=0.05,
    )


def peaked(rows_columns: list[tuple[int, int]]) -> np.ndarray:
    maps = np.zeros((len(rows_columns), 32, 32), np.float32)
    for one, place in zip(maps, rows_columns, strict=True):
        one[place] = 1
    return maps


def test_shares_at_the_limit() -> None:
    """At limit 2: two of three edits fail, one of two held-out presses, one of two others, the relit one. A score at
    the limit passes. One of three peaks lies far from the damage. Equal scores count half."""
    scores = np.array([1.0, 2.5, 3.0, 2.0, 4.0, 1.0, 2.2, 9.0])
    maps = peaked([(0, 0), (0, 0), (10, 10), (19, 13), (20, 13), (0, 0), (0, 0), (0, 0)])
    maps[3] = peaked([(28, 28)])[0]
    maps[4] = peaked([(19, 13)])[0]
    found = limit_columns(2.0, known(), maps, scores, np.ones((1, 5)))
    assert {name: float(column[0]) for name, column in found.items()} == {
        "detected": pytest.approx(2 / 3),
        "peak_found": pytest.approx(2 / 3),
        "false_alarms": 0.5,
        "relit_alarms": 1.0,
        "others_detected": 0.5,
        "others_auroc": 0.375,
    }


def test_a_peak_is_found_within_six_pixels() -> None:
    """On the damage and 6 pixels from it, not at 7, and never without damage."""
    masks = np.zeros((4, 32, 32), np.bool_)
    masks[:3, 10:14, 10:14] = True
    found = is_on_damage(peaked([(11, 11), (19, 13), (20, 13), (11, 11)]), masks)
    assert found.tolist() == [True, True, False, False]


def noisy(alpha: float | None) -> Trial:
    """Sixteen noisy grey presses to learn; four more sound, four with a black square, two white ones, two noisy."""
    rng = np.random.default_rng(0)
    noise = rng.integers(110, 140, (28, 64, 64, 3), dtype=np.uint8)
    frames, masks = noise[:12], np.zeros((12, 64, 64), np.bool_)
    masks[4:8, 24:40, 24:40] = True
    frames[masks] = 0
    frames[8:10] = 255
    nominal = NominalPresses(noise[12:], tuple(map(str, range(16))))
    kind = np.repeat([0, 1, 2], [8, 2, 2])
    return Trial("noisy", nominal, frames, masks, kind == 1, kind == 2, alpha)


def test_the_evaluation_fits_the_limit_where_a_rate_is_stated() -> None:
    """Black squares fail, and of four sound presses one at most: 1 in 17 is the best that 16 presses promise. A trial
    without a rate has the old measures alone."""
    rows = {}
    trunk = {"random": random_trunk()}
    for alpha in (0.05, None):
        chosen = {"noisy": EvaluationSet("Noisy", "Squares.", (lambda alpha=alpha: noisy(alpha),))}
        found = evaluate(trunk, chosen, ("padim",), replicates=4)
        rows[alpha] = found["sets"]["noisy"]["rows"][0]["measures"]
    measures = {name: measure["value"] for name, measure in rows[0.05].items()}
    assert measures["detected"] == measures["peak_found"] == measures["image_auroc"] == 1
    assert max(measures["false_alarms"], measures["relit_alarms"]) <= 0.25
    assert measures["others_detected"] == measures["others_auroc"] == 1
    assert measures["aupro_fpr05"] > measures["aupro_fpr01"]
    old = ["image_auroc", "pixel_auroc", "pixel_auprc", "aupro_fpr01"]
    assert list(rows[None]) == old
