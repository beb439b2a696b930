"""The whole path on real GelSight Mini frames: presses of a ball are nominal, other imprints and marks are not.

The maker of the frames pressed one ball at many places, so this is no fixtured part: only gross differences are asked
for here.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.presses.scatter import scatter_warnings
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge import registry
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.scorer import Scorer

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


@pytest.fixture(scope="module")
def gelslam(real_tactile: Path) -> Path:
    return real_tactile / "rpl-cmu__gelslam"


@pytest.fixture(scope="module")
def scorer(gelslam: Path) -> Scorer:
    """PCA subspace on 24 presses of the 6.31 mm ball, the free gel known."""
    folders = [gelslam / "6.310mm" / str(k) for k in range(24)]
    presses = read_presses(folders, PROFILE, REGION, no_contact=[gelslam / "background.png"])
    assert len(presses.touches) == 24
    detector = registry.detector("subspace")
    trunk = open_trunk(DEFAULT_BACKBONE, detector.taps(detector.parameters()))
    config = FitConfig("ball", "any", PROFILE, REGION, detector, trunk)
    return Scorer(fit_files(presses, config, created="test").bundle())


def load(path: Path) -> np.ndarray:
    """A real picture of any size in the profile's, cut to the region."""
    return read_presses([path], PROFILE, REGION, resize=True).frames[0]


def test_other_presses_of_the_ball_pass(scorer: Scorer, gelslam: Path) -> None:
    """Sixteen presses that are not in the bank: at most two false alarms where one is expected."""
    limit = scorer.bundle.manifest.threshold.value
    held = [load(gelslam / "6.310mm" / str(k) / "gelsight.png") for k in range(24, 40)]
    alarms = sum(scored.anomaly_score > limit for scored in scorer.score_batch(np.stack(held)))
    assert alarms <= 2


def test_threads_of_another_part_fail(scorer: Scorer, real_tactile: Path) -> None:
    """Three threaded parts on another sensor score above the threshold, where no more than two balls of 16 do."""
    limit = scorer.bundle.manifest.threshold.value
    for path in sorted((real_tactile / "RavenLiang1005__UniCal" / "GelSight").glob("*.png")):
        assert scorer.score(load(path)).anomaly_score > 1.2 * limit


def test_a_mark_raises_the_map_where_it_is(scorer: Scorer, gelslam: Path) -> None:
    """A dark stroke drawn into a real free gel: the map's peak is on it, within the blur of the features."""
    clean = load(gelslam / "background.png")
    marked = clean.copy()
    cv2.line(marked, (60, 150), (100, 180), (40, 40, 40), 4)
    risen = scorer.score(marked).score_map - scorer.score(clean).score_map
    row, column = np.unravel_index(int(risen.argmax()), risen.shape)
    assert 135 <= row <= 195
    assert 45 <= column <= 115


def test_balls_that_lie_anywhere_without_the_free_gel_are_not_proven(gelslam: Path) -> None:
    """24 pictures of one ball at many places: padim is warned of, with what to do; inreach takes any place."""
    presses = read_presses([gelslam / "6.310mm" / str(k) for k in range(24)], PROFILE, REGION)
    (said,) = scatter_warnings(presses, PROFILE, registry.detector("padim"))
    assert said.startswith("not proven: half of the presses lie more than")
    assert "give the free gel with --no-contact" in said
    assert scatter_warnings(presses, PROFILE, registry.detector("inreach")) == []
