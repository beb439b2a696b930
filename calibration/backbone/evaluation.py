"""Backbones side by side: the same detectors, presses and measures, on trunks that differ in their weights alone.

`python3 -m calibration.backbone.evaluation --out FOLDER NAME=TRUNK ...` writes `tactile_resnet18_evaluation.json`,
which the model card prints. A trunk is an installed backbone's name or a path ending in `.onnx`.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.backbone.evaluation_sets import SCENE_SEED, Trial, real_trials, simulated_trials
from calibration.backbone.package import NAME
from calibration.backbones import open_trunk
from calibration.features import extract, trunk_grid
from calibration.metrics import image_weights, interval, pixel_measures
from edge import registry
from edge.core.detector import Detector, Features, Grid, Nominal
from edge.core.errors import ConfigError, GelgateError
from edge.packing import pack, unpack
from edge.runtime import open_session

__all__ = ["DETECTORS", "Column", "evaluate", "main", "trial_columns"]

DETECTORS = ("padim", "spade", "fapm", "inreach")
_MEASURES = ("image_auroc", "pixel_auroc", "pixel_auprc", "aupro_fpr01")
_FALSE_ALARMS = 0.01
_PIXELS_PER_MM = 1 / 0.0634
_THREADS = 1

Column = NDArray[np.float64]
"""One measure: its value, then one value per bootstrap replicate."""


@dataclass(frozen=True)
class _Taken:
    """The features of one trial by one trunk."""

    grid: Grid
    nominal: Nominal
    scored: Features


def evaluate(
    trunks: dict[str, bytes],
    sets: dict[str, Callable[[], Iterable[Trial]]],
    detectors: Sequence[str] = DETECTORS,
    *,
    replicates: int = 200,
    say: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """One row per set, trunk and detector: the mean of each measure over the set's trials, with 95 % intervals.

    trunks: name to graph. The intervals are bootstrapped over presses, within each trial.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for title, trials in sets.items():
        columns: dict[tuple[str, str], list[dict[str, Column]]] = {}
        names: list[str] = []
        for trial in trials():
            names.append(trial.name)
            for trunk, graph in trunks.items():
                taken = _features(graph, trial)
                for method in detectors:
                    one = trial_columns(registry.load("detectors", method), taken, trial, replicates)
                    columns.setdefault((trunk, method), []).append(one)
                    first = ", ".join(f"{name} {column[0]:.3f}" for name, column in one.items())
                    say(f"{title} / {trial.name} / {trunk} / {method}: {first}")
        found[f"{title} ({', '.join(names)})"] = [
            {
                "backbone": trunk,
                "detector": method,
                "measures": {name: _mean(rows, name) for name in rows[0]},
                "trials": {
                    trial: {name: _plain(column[0]) for name, column in row.items()}
                    for trial, row in zip(names, rows, strict=True)
                },
            }
            for (trunk, method), rows in columns.items()
        ]
    return {"format": 1, "scene_seed": SCENE_SEED, "replicates": replicates, "sets": found}


def _mean(rows: list[dict[str, Column]], name: str) -> dict[str, Any]:
    column = np.mean([row[name] for row in rows], axis=0)
    span = interval(column[1:]) if len(column) > 1 else None
    return {
        "value": _plain(column[0]),
        "over_images": None if span is None else [_plain(end) for end in span],
    }


def _plain(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _features(graph: bytes, trial: Trial) -> _Taken:
    session = open_session(graph, _THREADS, "trunk")
    taps = [output.name for output in session.get_outputs()]
    shape = (trial.frames.shape[1], trial.frames.shape[2])
    grid = trunk_grid(session, taps, shape, _PIXELS_PER_MM)

    def take(frames: NDArray[np.uint8]) -> Features:
        return extract(session, frames, grid, lambda fraction: None)

    free = trial.nominal.no_contact
    nominal = Nominal(take(trial.nominal.frames), trial.nominal.touched, None if free is None else take(free))
    return _Taken(grid, nominal, take(trial.frames))


def trial_columns(detector: Detector, taken: _Taken, trial: Trial, replicates: int) -> dict[str, Column]:
    """The measures of one detector on one trial. `foreign_out` is there where the trial has foreign frames: the share
    of them that score above every sound held-out press.
    """
    maps, scores = _scored(detector, taken)
    own = ~trial.is_foreign
    masks = trial.masks[own]
    label = np.array([bool(mask.any()) for mask in masks])
    drawn = image_weights(label, replicates, np.random.default_rng(0))
    weights = np.concatenate([np.ones((1, len(label))), drawn])
    pixel = pixel_measures(maps[own], masks, weights, _FALSE_ALARMS)
    values = (
        _image_auroc(scores[own], label, weights),
        pixel.auroc,
        pixel.average_precision,
        pixel.aupro,
    )
    columns = dict(zip(_MEASURES, values, strict=True))
    if trial.is_foreign.any():
        share = (scores[trial.is_foreign] > scores[own][~label].max()).mean()
        # The foreign frames are a handful that was picked, not drawn: an interval would promise too much.
        columns["foreign_out"] = np.concatenate([[share], np.full(replicates, np.nan)])
    return columns


def _scored(detector: Detector, taken: _Taken) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Score maps (n, h, w) and anomaly scores (n,) by the detector's own graph."""
    parameters = detector.parameters("corrected")
    taps = detector.taps(parameters)
    grid = Grid(taken.grid.frame, {t: taken.grid.taps[t] for t in taps}, taken.grid.pixels_per_mm)
    bank = detector.fit(taken.nominal, grid, parameters, np.random.default_rng(0), lambda fraction: None)
    head = open_session(detector.head(grid, bank, parameters), _THREADS, f"head of {detector.name}")
    wanted = {given.name for given in head.get_inputs()}
    stored = {
        name: unpack(pack(array, packing), packing)
        for name, array in bank.arrays.items()
        if name in wanted
        for packing in [bank.packing.get(name, "none")]
    }
    answers = [_one(head, stored, taken.scored, wanted, k) for k in range(len(taken.scored[taps[0]]))]
    return np.stack([m for m, _ in answers]), np.array([s for _, s in answers])


def _one(
    head: ort.InferenceSession, stored: dict[str, NDArray[Any]], features: Features, wanted: set[str], k: int
) -> tuple[NDArray[np.float32], float]:
    taps = {tap: maps[k : k + 1] for tap, maps in features.items() if tap in wanted}
    score_map, score = head.run(["score_map", "score"], {**taps, **stored})
    return score_map[0], float(score[0])


def _image_auroc(scores: NDArray[np.float64], label: NDArray[np.bool_], weights: Column) -> Column:
    """The share of (damaged, sound) pairs in the right order under each weighting, ties counting half."""
    bad, good = scores[label], scores[~label]
    wins = (bad[:, None] > good).astype(np.float64) + 0.5 * (bad[:, None] == good)
    w_bad, w_good = weights[:, label], weights[:, ~label]
    right: Column = ((w_bad @ wins) * w_good).sum(axis=1) / (w_bad.sum(axis=1) * w_good.sum(axis=1))
    return right


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    parser = argparse.ArgumentParser(
        prog="calibration.backbone.evaluation", description=__doc__.splitlines()[0]
    )
    parser.add_argument("trunks", nargs="+", metavar="NAME=TRUNK")
    parser.add_argument("--out", type=Path, required=True, help="folder of the evaluation file")
    parser.add_argument("--real", type=Path, help="folder of real tactile frames")
    parser.add_argument("--parts", nargs="*", default=[], help="part analogues, all when not given")
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--keep", type=Path, help="folder for the simulated pictures, kept for the next time")
    given = parser.parse_args(words)
    try:
        pairs = [word.partition("=") for word in given.trunks]
        trunks = {name: open_trunk(trunk or name).graph for name, _, trunk in pairs}
        with tempfile.TemporaryDirectory(prefix="gelgate-evaluation-") as fresh:
            folder, parts = given.keep or Path(fresh), tuple(given.parts)
            sets: dict[str, Callable[[], Iterable[Trial]]] = {
                "Unseen parts": lambda: simulated_trials(folder, is_unseen_sensor=False, parts=parts),
                "Unseen parts on an unseen sensor": lambda: simulated_trials(
                    folder, is_unseen_sensor=True, parts=parts
                ),
            }
            if given.real:
                sets["Real presses"] = lambda: real_trials(given.real)
            found = evaluate(
                trunks, sets, replicates=given.replicates, say=lambda line: print(line, file=sys.stderr)
            )
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / f"{NAME}_evaluation.json").write_text(json.dumps(found, indent=1) + "\n")
    except GelgateError as error:
        print(error, file=sys.stderr)
        return 3 if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
