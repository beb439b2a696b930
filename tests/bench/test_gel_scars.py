"""What the record of a gel's scars costs with each press, next to the trunk that scores it."""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge.core.gel_scars.gel_scars import GelScars
from edge.core.gel_scars.press import ScoredPress
from edge.core.gel_scars.without_marks import without_marks
from edge.core.imaging.region import Region
from edge.model.session import open_session

pytestmark = pytest.mark.bench

ROUNDS = 15


def median_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


def test_a_press_of_a_scarred_gel_costs_a_share_of_the_trunk(capsys: pytest.CaptureFixture[str]) -> None:
    """Twelve places above the limit, the free gel compared, the press scored again, the record renewed: one thread."""
    rng = np.random.default_rng(1)
    score_map = rng.random((224, 224), np.float32)
    for k in range(12):
        row, column = 16 * k + 8, (53 * k) % 200
        score_map[row : row + 8, column : column + 12] = 3
    first = np.asarray(120 + rng.standard_normal((120, 160, 3)), np.float32)
    free, left = (
        first + rng.standard_normal(first.shape, np.float32),
        20 * rng.standard_normal(first.shape, np.float32),
    )
    free[60:64, 40:120] += 20
    session = open_session(open_trunk(DEFAULT_BACKBONE).graph, 1, "trunk")
    frames = rng.integers(0, 255, (1, 224, 224, 3), dtype=np.uint8)
    size, region = (320, 240), Region.centre((320, 240))

    def score_map_again(change: np.ndarray) -> np.ndarray:
        session.run(None, {"frames": without_marks(frames[0], change, size, region)[None]})
        return score_map

    press = ScoredPress(
        score_map,
        1.0,
        region,
        size,
        (0.0634, 0.0634),
        np.ones((120, 160), bool),
        without=score_map_again,
    )
    gel = GelScars(first=first)

    trunk_ms = median_ms(lambda: session.run(None, {"frames": frames}))
    quiet = replace(press, score_map=np.zeros_like(score_map))
    quiet_ms = median_ms(lambda: GelScars(first=first).judge(quiet, free, left))
    scars_ms = median_ms(lambda: gel.judge(press, free, left))

    with capsys.disabled():
        print(
            f"\ntrunk {trunk_ms:.1f} ms; a quiet press {quiet_ms:.1f} ms, {quiet_ms / trunk_ms:.0%} of it; with twelve "
            f"places above the limit {scars_ms:.1f} ms, {scars_ms / trunk_ms:.0%}; "
            f"record {gel.record.planes.nbytes / 1e3:.0f} kB"
        )
