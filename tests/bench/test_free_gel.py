"""Fits without a picture of the free gel, with the right one and with one of another light: what each finds.

pytest tests/bench/test_free_gel.py -m bench -s
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.experiments.backbones.real_touch import OBJECTS, real_touch_trial
from calibration.experiments.backbones.trial import PROFILE, REGION, Trial
from calibration.fitting.candidates import Candidates
from calibration.fitting.damage.conditions import relight
from calibration.fitting.detection_choice import choose_detection
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.trunks import open_trunk
from calibration.metrics import aupro, auroc
from edge import registry
from edge.core.errors import PoseNotFound
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer

pytestmark = pytest.mark.bench


def save(path: Path, rgb: np.ndarray) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]))
    return path


def fitted(presses: NominalPresses) -> Bundle:
    """A fit without options."""
    candidates = Candidates.of("padim", "auto")
    padim = registry.detector("padim")
    trunk = open_trunk(candidates.trunks[0], padim.taps(padim.parameters()))
    config = FitConfig("part", "top", PROFILE, REGION, padim, trunk, register="auto", augment="auto")
    return fit_files(presses, choose_detection(presses, config, candidates), created="2026-01-01").bundle()


def found(bundle: Bundle, trial: Trial) -> str:
    frames, masks = trial.frames[trial.is_own], trial.masks[trial.is_own]
    maps, scores, scorer = np.zeros(masks.shape, np.float32), np.full(len(masks), np.inf), Scorer(bundle)
    for k, rgb in enumerate(frames):
        try:
            scored = scorer.score(rgb)
        except PoseNotFound:  # rejected
            continue
        maps[k], scores[k] = scored.score_map, scored.anomaly_score
    is_edited, fails = masks.any(axis=(1, 2)), scores > bundle.manifest.threshold.value
    ranks = np.minimum(scores, 1e9)
    return (
        f"AUROC {auroc(ranks, is_edited):.3f}, AU-PRO {aupro(list(maps), list(masks)):.3f}, reported "
        f"{fails[is_edited].mean():.2f}, false alarms {fails[~is_edited].sum()} of {(~is_edited).sum()}"
    )


@pytest.mark.parametrize(
    "name", ["ball 6.31 mm, anywhere", "ball 9.47 mm, anywhere", "finger on a marker gel"]
)
def test_the_free_gel(name: str, real_tactile: Path, tmp_path: Path) -> None:
    """Prints a line for each."""
    presses = next(one for one in OBJECTS if one.name == name).read(real_tactile)
    for number, rgb in presses.learnt.items():
        save(tmp_path / "learnt" / f"{number}.png", rgb)
    right = save(tmp_path / "free" / "right.png", presses.free)
    wrong = save(tmp_path / "free" / "wrong.png", relight(presses.free, np.random.default_rng(1)))
    trial = real_touch_trial(real_tactile, name)
    given: dict[str, Sequence[Path]] = {"none": [], "right": [right], "another light": [wrong]}
    for how, files in given.items():
        read = read_presses([tmp_path / "learnt"], PROFILE, REGION, no_contact=files)
        print(f"{name}, {how}: {found(fitted(read), trial)}; {read.estimated or 'the given picture'}")
