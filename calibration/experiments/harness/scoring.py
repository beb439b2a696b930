"""One cell's work: a bank from nominal presses, the score maps of the test presses, and the measures."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from statistics import median
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.metrics.pixel import pool_measures
from calibration.metrics.summary import auroc, recall_at
from calibration.threads import one_blas_thread
from edge.core.detector import Bank, Detector, Grid, Mode, Nominal
from edge.core.errors import FitError, NotScorable
from edge.model.packing import Packed, pack, unpack
from edge.model.session import RUNTIME_ERRORS, open_session

__all__ = ["MEASURES", "Scored", "TestPresses", "fit_and_score", "measures", "run_head"]

MEASURES = ("aupro_001", "aupro_005", "auprc", "pixel_auroc", "image_auroc", "recall_001")
"""AU-PRO up to 1 % and 5 % false positives, average precision, AUROC by pixel and by press, and the share of defective
presses found with at most 1 % of the nominal test presses above the threshold."""

_LIMITS = (0.01, 0.05)
_FALSE_ALARMS = 0.01


@dataclass(frozen=True)
class TestPresses:
    """What is scored."""

    __test__ = False  # no test case of pytest

    features: Mapping[str, Sequence[NDArray[np.float32]]]
    """Tap to a map (1, c, h, w) of each press, in memory or in a file."""
    masks: NDArray[np.bool_]
    """bool (n, h, w)."""
    is_defective: NDArray[np.bool_]
    """bool (n,)."""

    def __len__(self) -> int:
        return len(self.is_defective)

    @classmethod
    def join(cls, every: Sequence["TestPresses"]) -> "TestPresses":
        """Return the presses of all of them, in their order."""
        features = {tap: [found for one in every for found in one.features[tap]] for tap in every[0].features}
        masks, labels = ([getattr(one, name) for one in every] for name in ("masks", "is_defective"))
        return cls(features, np.concatenate(masks), np.concatenate(labels))


@dataclass(frozen=True)
class Scored:
    """maps: float32 (n, h, w). scores: float64 (n,). milliseconds: of the head, per press."""

    maps: NDArray[np.float32]
    scores: NDArray[np.float64]
    milliseconds: tuple[float, ...]

    @property
    def digest(self) -> str:
        """The hash of maps and scores: two cells with the same one are the same computation."""
        found = hashlib.sha256(np.ascontiguousarray(self.maps).data)
        found.update(self.scores.tobytes())
        return found.hexdigest()[:16]


@one_blas_thread()
def fit_and_score(
    detector: Detector,
    mode: Mode,
    nominal: Nominal,
    grid: Grid,
    test: TestPresses,
    *,
    seed: int,
    overrides: Mapping[str, object] | None = None,
    also: Callable[["Scored"], Mapping[str, Any]] = lambda result: {},
) -> dict[str, Any]:
    """The measures of MEASURES (None where undefined), and what they cost.

    fit_s, score_s, measure_s: seconds of the stages; with `cpu_` in front, processor seconds. score_ms: median
    milliseconds of the head per press, on one thread. bank_bytes: as stored. presses: nominal presses of the fit.
    scores_sha256: equal for cells with equal results. also: more columns from the scores.
    Errors: FitError, NotScorable.
    """
    parameters = detector.parameters(mode, **(overrides or {}))
    seconds: dict[str, float] = {}
    with _time(seconds, "fit_s"):
        bank = detector.fit(nominal, grid, parameters, np.random.default_rng(seed), lambda fraction: None)
    with _time(seconds, "score_s"):
        packed = _pack_arrays(bank)
        stored = {key: unpack(array, bank.packing.get(key, "none")) for key, array in packed.items()}
        session = _session(detector.head(grid, bank, parameters), detector.name)
        result = run_head(session, stored, test.features, detector.name)
    with _time(seconds, "measure_s"):
        found = {**measures(result, test), **also(result)}
    return {
        **found,
        "presses": nominal.presses,
        "test_nominal": int((~test.is_defective).sum()),
        "test_defective": int(test.is_defective.sum()),
        "bank_bytes": sum(
            one.data.nbytes + (0 if one.scale is None else one.scale.nbytes) for one in packed.values()
        ),
        "score_ms": round(median(result.milliseconds), 4),
        **seconds,
        "scores_sha256": result.digest,
    }


@contextmanager
def _time(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Add the seconds of a stage, by the clock and of the processor."""
    start, spent = time.perf_counter(), time.process_time()
    yield
    seconds[stage] = round(time.perf_counter() - start, 4)
    seconds[f"cpu_{stage}"] = round(time.process_time() - spent, 4)


def run_head(
    session: ort.InferenceSession,
    arrays: Mapping[str, NDArray[Any]],
    features: Mapping[str, Sequence[NDArray[np.float32]]],
    name: str,
) -> Scored:
    """Score each press alone, as the gateway does: it has a map (1, c, h, w) for every tap.

    arrays: the bank as it is read from a bundle. Errors: FitError where the head does not run; NotScorable for a map
    that is not finite.
    """
    wanted = {given.name for given in session.get_inputs()}
    bank = {key: array for key, array in arrays.items() if key in wanted}
    used = {tap: maps for tap, maps in features.items() if tap in wanted}
    maps, scores, took = [], [], []
    for press in zip(*used.values(), strict=True):
        taps = {tap: np.ascontiguousarray(one) for tap, one in zip(used, press, strict=True)}
        start = time.perf_counter()
        try:
            score_map, score = session.run(["score_map", "score"], {**taps, **bank})
        except RUNTIME_ERRORS as error:
            raise FitError(f"the head of {name} does not run on a test press: {error!s:.300}") from error
        took.append(1e3 * (time.perf_counter() - start))
        maps.append(score_map[0])
        scores.append(float(score[0]))
    found = Scored(np.stack(maps), np.array(scores), tuple(took))
    if not (np.isfinite(found.maps).all() and np.isfinite(found.scores).all()):
        raise NotScorable(f"{name} gives a score that is not finite on a test press")
    return found


@lru_cache(maxsize=4)
def _session(head: bytes, name: str) -> ort.InferenceSession:
    """Kept for the next cells: the stored heads are the same for every bank."""
    return open_session(head, 1, f"head of {name}")


def _pack_arrays(bank: Bank) -> dict[str, Packed]:
    try:
        return {key: pack(array, bank.packing.get(key, "none")) for key, array in bank.arrays.items()}
    except ValueError as error:
        raise FitError(f"the bank cannot be stored: {error}") from error


def measures(result: Scored, test: TestPresses) -> dict[str, float | None]:
    """Every one of MEASURES, exact; None where it is undefined."""
    pixel = pool_measures(result.maps, test.masks, _LIMITS)
    (recall,) = recall_at(result.scores, test.is_defective, np.ones((1, len(test))), _FALSE_ALARMS)
    return {
        "aupro_001": pixel.aupro[0],
        "aupro_005": pixel.aupro[1],
        "auprc": pixel.average_precision,
        "pixel_auroc": pixel.auroc,
        "image_auroc": auroc(result.scores, test.is_defective),
        "recall_001": float(recall) if np.isfinite(recall) else None,
    }
