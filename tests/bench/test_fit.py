"""What a fit costs beside the features that it is made from, in processor time: the bank, and the threshold's folds.

Run with one thread: `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 pytest tests/bench/test_fit.py -m bench -s`;
GELGATE_BENCH_BACKBONE names another small backbone. Budget: the
bank takes at most twice the time of extracting the features. The folds are as many banks again, each on four fifths.
"""

import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge import registry
from edge.core.detector import Features, Grid, Nominal
from edge.model.graph_cut import cut_trunk
from edge.model.session import open_session
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

pytestmark = pytest.mark.bench

BACKBONE = os.environ.get("GELGATE_BENCH_BACKBONE", DEFAULT_BACKBONE)
METHODS = ("padim", "subspace", "spade", "fapm", "inreach", "patchcore")
TAPS = ("layer1", "layer2", "layer3")
FOLDS = 5


def spent(work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the process's own time, and the result."""
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def frames(n: int) -> np.ndarray:
    """Smooth pictures that differ a little from press to press, uint8 (n, 224, 224, 3)."""
    rng = np.random.default_rng(0)
    each = rng.integers(60, 200, (14, 14, 3)) + rng.normal(0, 6, (n, 14, 14, 3))
    large = np.stack(
        [cv2.resize(p.astype(np.float32), (224, 224), interpolation=cv2.INTER_CUBIC) for p in each]
    )
    rgb: np.ndarray = np.clip(large + rng.normal(0, 1.5, large.shape), 0, 255).astype(np.uint8)
    return rgb


@pytest.mark.parametrize(("name", "presses"), [(BACKBONE, 40), ("wide_resnet50_2", 20)])
def test_fit_beside_extraction(name: str, presses: int) -> None:
    """Prints one line per method at its default: all cells touched, the most that a fit can have to do.

    The features are those that the fit makes: of a trunk cut behind the last tap that is read.
    """
    is_wide = name == "wide_resnet50_2"
    whole = build_trunk(random_state(name), name, TAPS) if is_wide else open_trunk(name, TAPS).graph
    print(f"\n{name}, {presses} presses, processor time")
    known = {}
    for method in METHODS:
        detector = registry.detector(method)
        parameters = detector.parameters()
        last = max(detector.taps(parameters))
        if last not in known:
            session = open_session(cut_trunk(whole, [tap for tap in TAPS if tap <= last]), 1, "trunk")
            taps = [tap for tap in TAPS if tap <= last]
            grid = trunk_grid(session, taps, (224, 224), 15.77)
            work = partial(extract, session, frames(presses), grid, lambda done: None)
            known[last] = *spent(work), grid
        extraction, features, grid = known[last]
        less = {tap: maps[: presses - presses // FOLDS] for tap, maps in features.items()}
        alone, fold = (spent(partial(fit, detector, some, grid))[0] for some in (features, less))
        print(
            f"  {method:10s} features to {last} {extraction:.2f} s, bank {alone:5.2f} s = {alone / extraction:5.2f} x; "
            f"with {FOLDS} folds {(alone + FOLDS * fold) / extraction:6.2f} x"
        )


def fit(detector: Any, features: Features, grid: Grid) -> Any:
    rng = np.random.default_rng(0)
    return detector.fit(Nominal(features), grid, detector.parameters(), rng, lambda done: None)
