"""What registration is worth where parts lie anywhere, and what it costs.

Simulated parts lie up to 3 mm off and turned by any angle; the same parts in a fixture are the comparison. Real balls
are pressed anywhere in the picture. The figures of docs/detectors.md are from here.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort
import pytest
from numpy.typing import NDArray

from calibration.benchmark.evaluation import compared_detectors
from calibration.benchmark.presses import development_trial, part_trial
from calibration.benchmark.real_touch import real_touch_trial
from calibration.benchmark.trial import PROFILE, REGION, Trial
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.registration import learn_pose
from calibration.fitting.trunks import open_trunk
from calibration.metrics import pixel_measures
from edge import registry
from edge.core.errors import PoseNotFound
from edge.core.registration.registrar import Registrar
from edge.model.scorer import Scorer
from edge.model.tile_runner import most_typical

pytestmark = pytest.mark.bench

SIMULATED: dict[str, Callable[[str], Trial]] = {
    **{
        f"RP{k}": partial(lambda k, condition: development_trial(k, condition=condition), k) for k in range(3)
    },
    **{name: partial(part_trial, name) for name in ("PZ1", "PZ3", "PZ5")},
}
# Random parts on which no choice of registration was made.
JUDGED: dict[str, Callable[[str], Trial]] = {
    f"RP{k}": partial(lambda k, condition: development_trial(k, condition=condition), k)
    for k in range(60, 66)
}
BALLS = ("ball 6.31 mm, anywhere", "ball 9.47 mm, anywhere")
METHODS = ("padim", "spade", "fapm", "subspace")


def _measures(trial: Trial, method: str, register: str) -> tuple[float, float, int]:
    """AU-PRO up to 1 %, image AUROC, and how many presses were rejected."""
    detector = registry.detector(method)
    trunk = open_trunk("tactile_resnet18", detector.taps(detector.parameters()))
    config = FitConfig(
        "P",
        "1",
        PROFILE,
        REGION,
        detector,
        trunk,
        threshold=1.0,
        threads=1,
        is_scattered=True,
        register=register,  # type: ignore[arg-type]
    )
    nominal = trial.nominal if register == "never" else replace(trial.nominal, touched=None)
    scorer = Scorer(fit_files(nominal, config, created="2026-01-01").bundle(), 1)
    maps, scores, rejected = [], [], 0
    for rgb in trial.frames[trial.is_own]:
        try:
            scored = scorer.score(rgb)
        except PoseNotFound:
            rejected += 1
            maps.append(np.zeros(rgb.shape[:2], np.float32))
            scores.append(0.0)
        else:
            maps.append(scored.score_map)
            scores.append(scored.anomaly_score)
    masks = trial.masks[trial.is_own]
    weights = np.ones((1, len(masks)))
    pro = float(pixel_measures(np.stack(maps), masks, weights, 0.01).aupro[0])
    return pro, _auroc(np.array(scores), masks.any(axis=(1, 2))), rejected


def _auroc(scores: NDArray[np.float64], is_damaged: NDArray[np.bool_]) -> float:
    bad, good = scores[is_damaged], scores[~is_damaged]
    return float((bad[:, None] > good).mean() + 0.5 * (bad[:, None] == good).mean())


def _line(name: str, found: dict[str, list[tuple[float, float, int]]]) -> None:
    cells = (
        f"{method} {np.mean([row[0] for row in rows]):.3f} / {np.mean([row[1] for row in rows]):.3f}"
        + (f" ({sum(row[2] for row in rows)} rejected)" if any(row[2] for row in rows) else "")
        for method, rows in found.items()
    )
    print(f"\n{name:44s} " + "   ".join(cells), end="", flush=True)


@pytest.mark.parametrize(
    ("condition", "register"), [("parts anywhere", "never"), ("parts anywhere", "always"), ("plain", "never")]
)
def test_simulated_parts(condition: str, register: str) -> None:
    """Prints AU-PRO up to 1 % and image AUROC of six parts, as they lie, registered, and in a fixture."""
    _print_parts(SIMULATED, condition, register)


@pytest.mark.parametrize(("condition", "register"), [("parts anywhere", "always"), ("plain", "never")])
def test_parts_of_judgement(condition: str, register: str) -> None:
    """The same of six other parts, opened once, after every choice."""
    _print_parts(JUDGED, condition, register)


def _print_parts(parts: Mapping[str, Callable[[str], Trial]], condition: str, register: str) -> None:
    found: dict[str, list[tuple[float, float, int]]] = {method: [] for method in METHODS}
    for name, make in parts.items():
        trial = make(condition)
        rows = {method: _measures(trial, method, register) for method in METHODS}
        _line(f"{name} {condition} {register}", {method: [row] for method, row in rows.items()})
        for method, row in rows.items():
            found[method].append(row)
    _line(f"mean {condition} {register}", found)


@pytest.mark.parametrize("register", ["never", "always"])
def test_real_balls_anywhere(real_tactile: Path, register: str) -> None:
    """The same of real balls, whose damage is rendered."""
    for name in BALLS:
        trial = real_touch_trial(real_tactile, name)
        _line(f"{name} {register}", {method: [_measures(trial, method, register)] for method in METHODS})


def test_time() -> None:
    """Prints the time of registration and of the bare trunk to layer1, on one thread: medians of one run."""
    trial = development_trial(1, condition="parts anywhere")
    assert trial.nominal.no_contact is not None
    part = learn_pose(trial.nominal.frames, most_typical(trial.nominal.no_contact)).part
    registrar = Registrar(part)
    cv2.setNumThreads(1)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    trunk = ort.InferenceSession(open_trunk("tactile_resnet18", ("layer1",)).graph, options)

    def timed(work: Callable[[], object]) -> float:
        """Processor time, which other work on the machine changes least."""
        start = time.thread_time()
        work()
        return time.thread_time() - start

    frames = np.tile(trial.frames, (4, 1, 1, 1))
    pairs = [(timed(partial(registrar.register, rgb)), timed(partial(_run, trunk, rgb))) for rgb in frames]
    registration, bare = np.median(pairs, axis=0) * 1e3
    print(
        f"\nregistration {registration:.1f} ms, trunk to layer1 {bare:.1f} ms, ratio {registration / bare:.2f}"
    )
    assert registration > 0


def _run(trunk: ort.InferenceSession, rgb: NDArray[np.uint8]) -> object:
    return trunk.run(["layer1"], {"frames": rgb[None]})


def test_place_wise_methods_are_among_them() -> None:
    """The table has every method that compares place with place."""
    assert {m for m in compared_detectors() if registry.detector(m).compares_places} <= set(METHODS)
