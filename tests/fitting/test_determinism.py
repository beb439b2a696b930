"""Same bundle, same frame, same score: over runs, batch sizes and threads, for every method."""

import numpy as np
import pytest

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge import registry
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Bundle
from edge.model.scorer import Scored, Scorer

SIDE = 96


def frames(n: int, seed: int) -> np.ndarray:
    """The same blocky part each time, with noise and a mark that moves; uint8 (n, 96, 96, 3)."""
    rng = np.random.default_rng(seed)
    base = np.random.default_rng(0).integers(60, 200, (SIDE // 8, SIDE // 8, 3)).repeat(8, 0).repeat(8, 1)
    rgb = np.clip(base + rng.normal(0, 5, (n, SIDE, SIDE, 3)), 0, 255).astype(np.uint8)
    for number in range(n):
        rgb[number, 8 * number : 8 * number + 6, 30:40] = 250 if seed else rgb[number, 0, 0]
    return rgb


@pytest.fixture(scope="module", params=registry.names("detectors"))
def bundle(request: pytest.FixtureRequest) -> Bundle:
    detector = registry.detector(request.param)
    config = FitConfig(
        part="pin",
        position="top",
        profile=SensorProfile("small", (SIDE, SIDE), (0.0, 0.0), (SIDE, SIDE), 1, 15.77),
        region=Region.full((SIDE, SIDE)),
        detector=detector,
        trunk=open_trunk(DEFAULT_BACKBONE, detector.taps(detector.parameters())),
        threshold=1.0,
    )
    return fit_files(NominalPresses(frames(8, 0), ("",) * 8), config, created="2026-01-01").bundle()


def beyond(found: list[Scored], expected: list[Scored], bundle: Bundle) -> float:
    """By how much scores and maps lie outside the manifest's tolerance; at most 0 where they keep it."""
    tolerance = bundle.manifest.tolerance
    worst = -np.inf
    for one, other in zip(found, expected, strict=True):
        score = abs(one.anomaly_score - other.anomaly_score) - tolerance.around(other.anomaly_score)
        score_map = np.abs(one.score_map - other.score_map) - (
            tolerance.score_map + tolerance.relative * np.abs(other.score_map)
        )
        worst = max(worst, score, float(score_map.max()))
    return worst


def test_scores_repeat(bundle: Bundle) -> None:
    """Runs to the bit; 1, 3 and 8 frames at once, and 1, 2 and 4 threads, within the tolerance, and within 1e-5."""
    asked = frames(8, 5)
    first, again = ([run.score_in_pose(frame) for frame in asked] for run in (Scorer(bundle), Scorer(bundle)))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.score_map, other.score_map)
        assert one.anomaly_score == other.anomaly_score
    top = max(float(scored.score_map.max()) for scored in first)
    for threads, sizes in ((1, (3, 8)), (2, (1, 8)), (4, (3,))):
        scorer = Scorer(bundle, threads)
        for size in sizes:
            found = [
                scored
                for start in range(0, 8, size)
                for scored in scorer.score_batch(asked[start : start + size])
            ]
            assert beyond(found, first, bundle) <= 0
            apart = max(
                float(np.abs(a.score_map - b.score_map).max()) for a, b in zip(found, first, strict=True)
            )
            assert apart <= 1e-5 * top
