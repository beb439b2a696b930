"""What a score costs against its bare trunk, per method, backbone and resolution; a row of ROWS is a measurement.

Run with `make bench` or `pytest tests/bench/test_scoring.py -m bench -s`. Frames are smooth random pictures: the time
does not depend on what they show. Trunk and full path are timed in turn, so that both see the same machine.
"""

import time
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import DEFAULT_BACKBONE, Trunk, open_trunk
from edge import registry
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions

ROUNDS = 60
THREADS = 2


@dataclass(frozen=True)
class Row:
    """One measurement: a method with its settings on a backbone, for a frame of (h, w), from n nominal presses."""

    method: str
    backbone: str = DEFAULT_BACKBONE
    frame: tuple[int, int] = (224, 224)
    presses: int = 20
    mode: str = "corrected"
    overrides: dict[str, object] = field(default_factory=dict)

    def __str__(self) -> str:
        h, w = self.frame
        extra = "".join(f" {k}={v}" for k, v in self.overrides.items())
        return f"{self.method} {self.mode}{extra}, {self.backbone}, {w}x{h}, {self.presses} presses"


METHODS = ("padim", "subspace", "spade", "fapm", "inreach", "patchcore")

ROWS = [*map(Row, METHODS), Row("padim", "wide_resnet50_2_random"), Row("padim", "tactile_resnet18_int8")]


def pictures(n: int, frame: tuple[int, int]) -> NDArray[np.uint8]:
    """Smooth random pictures, uint8 (n, h, w, 3): nominal presses that differ a little."""
    rng = np.random.default_rng(0)
    common = rng.integers(60, 200, (12, 16, 3)).astype(np.float32)
    each = common + rng.normal(0, 6, (n, 12, 16, 3)).astype(np.float32)
    h, w = frame
    large = [cv2.resize(picture, (w, h), interpolation=cv2.INTER_CUBIC) for picture in each]
    noisy = np.stack(large) + rng.normal(0, 1.5, (n, h, w, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module", autouse=True)
def heading() -> None:
    columns = ("trunk", "full", "head", "ratio", "stored", "in use", "features", "fit", "folds")
    print(f"\n{'':64}" + "".join(f"{name:>9}" for name in columns))


@pytest.mark.bench
@pytest.mark.parametrize("row", ROWS, ids=str)
def test_score_against_bare_trunk(row: Row) -> None:
    """Frame to score map takes its trunk's time and a little more: medians in ms, bank in MB, fit in s."""
    detector = registry.detector(row.method)
    parameters = detector.parameters(row.mode, **row.overrides)
    trunk = open_trunk(row.backbone, detector.taps(parameters))
    h, w = row.frame
    config = FitConfig(
        part="bench",
        position="any",
        profile=SensorProfile("bench", (w, h), (0.0, 0.0), (w, h), 1, LR_PIXELS_PER_MM * max(1.0, w / 320)),
        region=Region.full((w, h)),
        detector=detector,
        trunk=trunk,
        mode=row.mode,  # type: ignore[arg-type]
        overrides=row.overrides,
        threads=THREADS,
    )
    frames = pictures(row.presses, row.frame)
    fitted = fit_files(NominalPresses(frames, ("",) * row.presses), config, created="bench")
    sessions = TrunkSessions(THREADS)
    scorer = Scorer(fitted.bundle(), THREADS, sessions)
    bare, full = interleaved(scorer, sessions, trunk, frames)
    cost = fitted.manifest.cost
    assert cost is not None
    megabytes = cost.bank_bytes_stored / 1e6, cost.bank_bytes_unpacked / 1e6
    shown = bare, full, full - bare, full / bare, *megabytes, cost.features_s, cost.fit_s, cost.threshold_s
    print(f"{row!s:64}" + "".join(f"{value:9.2f}" for value in shown))


def interleaved(
    scorer: Scorer, sessions: TrunkSessions, trunk: Trunk, frames: NDArray[np.uint8]
) -> tuple[float, float]:
    """Median milliseconds of the bare trunk, its outputs bound, and of frame to score map, in turn."""
    session = sessions.get(trunk.sha256, None, "bench")
    binding = session.io_binding()
    binding.bind_cpu_input("frames", frames[:1])
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")
    times = np.empty((ROUNDS, 2))
    for k in range(ROUNDS):
        start = time.perf_counter()
        session.run_with_iobinding(binding)
        middle = time.perf_counter()
        scorer.score(frames[k % len(frames)])
        times[k] = middle - start, time.perf_counter() - middle
    bare, full = np.median(times[5:], axis=0) * 1e3
    return float(bare), float(full)
