"""One cell's work: a bank from nominal presses, the score maps of the test presses, and the measures."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import count_stored
from calibration.fitting.limits.held_out import Learner, ScoredPresses
from calibration.metrics.pixel import pool_measures
from calibration.metrics.summary import auroc, recall_at
from calibration.threads import one_blas_thread
from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Bank, Features, Nominal
from edge.core.errors import NotScorable

__all__ = ["MEASURES", "Also", "TestPresses", "fit_and_score", "measures", "score_presses"]

MEASURES = ("aupro_001", "aupro_005", "auprc", "pixel_auroc", "image_auroc", "recall_001")
"""AU-PRO up to 1 % and 5 % false positives, average precision, AUROC by pixel and by press, and the share of defective
presses found with at most 1 % of the nominal test presses above the threshold."""

_LIMITS = (0.01, 0.05)
_FALSE_ALARMS = 0.01


@dataclass(frozen=True)
class TestPresses:
    """What is scored of some presses."""

    __test__ = False  # no test case of pytest

    features: Features
    """Of all the presses, in memory or in a file."""
    rows: NDArray[np.int64]
    """Those that are scored, (n,)."""
    masks: Mask
    """bool (n, h, w)."""
    is_defective: Mask
    """bool (n,)."""


def score_presses(learner: Learner, bank: Bank, features: Features, rows: Sequence[int]) -> ScoredPresses:
    """Score each of these presses alone, as the gateway does.

    Errors: FitError where the head does not run; NotScorable for a map that is not finite.
    """
    scored = learner.score(bank, features, rows)
    if not (np.isfinite(scored.maps).all() and np.isfinite(scored.scores).all()):
        raise NotScorable(f"{learner.detector.name} gives a score that is not finite on a test press")
    return scored


Also = Callable[[Sequence[ScoredPresses]], Mapping[str, Any]]
"""Gives more columns, from the scores of each of the test presses."""


@one_blas_thread()
def fit_and_score(
    learner: Learner, nominal: Nominal, tests: Sequence[TestPresses], also: Also = lambda each: {}
) -> dict[str, Any]:
    """The measures of MEASURES of all tests together (None where undefined), and what they cost.

    fit_s, score_s, measure_s: seconds of the stages; with `cpu_` in front, processor seconds. score_ms: median
    milliseconds of the head per press, on one thread. bank_bytes: as stored. presses: nominal presses of the fit.
    scores_sha256: equal for cells with equal results. Errors: FitError, NotScorable.
    """
    seconds: dict[str, float] = {}
    with _time(seconds, "fit_s"):
        bank = learner.bank(nominal)
    with _time(seconds, "score_s"):
        each = [score_presses(learner, bank, test.features, test.rows.tolist()) for test in tests]
    with _time(seconds, "measure_s"):
        maps, scores, head_ms = (
            np.concatenate([getattr(one, name) for one in each]) for name in ("maps", "scores", "head_ms")
        )
        masks, is_defective = (
            np.concatenate([getattr(test, name) for test in tests]) for name in ("masks", "is_defective")
        )
        columns = {**measures(maps, scores, masks, is_defective), **also(each)}
    return {
        **columns,
        "presses": nominal.presses,
        "test_nominal": int((~is_defective).sum()),
        "test_defective": int(is_defective.sum()),
        "bank_bytes": count_stored(bank),
        "score_ms": round(float(np.median(head_ms)), 4),
        **seconds,
        "scores_sha256": hashlib.sha256(maps.tobytes() + scores.tobytes()).hexdigest()[:16],
    }


@contextmanager
def _time(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Add the seconds of a stage, by the clock and of the processor."""
    start, spent = time.perf_counter(), time.process_time()
    yield
    seconds[stage] = round(time.perf_counter() - start, 4)
    seconds[f"cpu_{stage}"] = round(time.process_time() - spent, 4)


def measures(maps: F32, scores: F64, masks: Mask, is_defective: Mask) -> dict[str, float | None]:
    """Every one of MEASURES, exact; None where it is undefined."""
    pixel = pool_measures(maps, masks, _LIMITS)
    (recall,) = recall_at(scores, is_defective, np.ones((1, len(scores))), _FALSE_ALARMS)
    return {
        "aupro_001": pixel.aupro[0],
        "aupro_005": pixel.aupro[1],
        "auprc": pixel.average_precision,
        "pixel_auroc": pixel.auroc,
        "image_auroc": auroc(scores, is_defective),
        "recall_001": float(recall) if np.isfinite(recall) else None,
    }
