"""Compares backbones: the same detectors, presses and measures on trunks with different weights."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import call
from typing import Any

import numpy as np

from calibration.experiments.backbones.sets import FORMAT, EvaluationSet, Trial
from calibration.experiments.harness.markdown import markdown_table
from calibration.fitting.limits.held_out import Learner, TapReader
from calibration.metrics.pixel import pixel_measures
from calibration.metrics.summary import image_auroc_of, image_weights, interval
from calibration.simulator.workers import in_order
from edge import registry
from edge.core.arrays import F64
from edge.core.detector import Features, Nominal
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.model.graph_cut import cut_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

__all__ = [
    "RANDOM",
    "evaluate",
    "evaluation_tables",
    "random_trunk",
]

RANDOM = "random"
"""The name of the column with random weights."""

_FALSE_ALARMS = 0.01

Column = F64
"""One measure: its value, then one value per bootstrap replicate."""

Columns = dict[str, Column]


def random_trunk() -> bytes:
    """Make a ResNet-18 with random weights, seed 0: what training is compared with."""
    return build_trunk(random_state("resnet18"), "resnet18")


def evaluate(
    trunks: Mapping[str, bytes],
    sets: Mapping[str, EvaluationSet],
    detectors: Sequence[str],
    *,
    replicates: int = 200,
    workers: int = 1,
    advance: Callable[[int], None] = lambda done: None,
) -> dict[str, Any]:
    """Measure one row per set, trunk and detector: the mean of each measure over the set's trials, with 95 % intervals.

    trunks: name to graph, the one that ships first. The intervals are bootstrapped over presses, within each trial.
    Brief sets compare the first trunk and `random` alone. advance: called with the trials done.
    """
    shallow = {name: cut_trunk(graph, _taps(detectors)) for name, graph in trunks.items()}
    brief = {name: graph for name, graph in shallow.items() if name in (next(iter(shallow)), RANDOM)}
    tasks = [
        partial(_measure, make, brief if chosen.is_brief else shallow, detectors, replicates)
        for chosen in sets.values()
        for make in chosen.trials
    ]
    measurements = []
    for measured in in_order(call, tasks, workers):
        measurements.append(measured)
        advance(len(measurements))
    results = iter(measurements)
    return {
        "format": FORMAT,
        "replicates": replicates,
        "settings": {method: dict(vars(registry.detector(method).parameters())) for method in detectors},
        "sets": {name: _write_set(of, [next(results) for _ in of.trials]) for name, of in sets.items()},
    }


def _measure(
    make: Callable[[], Trial],
    trunks: Mapping[str, bytes],
    detectors: Sequence[str],
    replicates: int,
) -> tuple[str, dict[tuple[str, str], Columns]]:
    """Measure one trial: its name, and (backbone, detector) to measures; runs in any process."""
    trial = make()
    scored = {}
    for trunk, graph in trunks.items():
        reader = TapReader(graph, _taps(detectors), trial.frames.shape[1:3], LR_PIXELS_PER_MM)
        nominal, features = reader.nominal(trial.nominal), reader.take(trial.frames)
        for method in detectors:
            learner = reader.learner(registry.detector(method))
            scored[trunk, method] = _trial_columns(learner, nominal, features, trial, replicates)
    return trial.name, scored


def _taps(detectors: Sequence[str]) -> tuple[str, ...]:
    """Every tap that one of the detectors reads."""
    loaded = [registry.detector(method) for method in detectors]
    return tuple(sorted({tap for detector in loaded for tap in detector.taps(detector.parameters())}))


def _write_set(
    of: EvaluationSet, trials: Sequence[tuple[str, dict[tuple[str, str], Columns]]]
) -> dict[str, Any]:
    rows = []
    for trunk, method in trials[0][1]:
        columns = {name: scored[trunk, method] for name, scored in trials}
        rows.append(
            {
                "backbone": trunk,
                "detector": method,
                "measures": {name: _mean(columns.values(), name) for name in trials[0][1][trunk, method]},
                "trials": {
                    trial: {name: _plain(column[0]) for name, column in own.items()}
                    for trial, own in columns.items()
                },
            }
        )
    return {"title": of.title, "text": of.text, "trials": [name for name, _ in trials], "rows": rows}


def _mean(trials: Iterable[Columns], name: str) -> dict[str, Any]:
    column = np.mean([own[name] for own in trials], axis=0)
    span = interval(column[1:]) if len(column) > 1 else None
    return {"value": _plain(column[0]), "over_images": span and [_plain(end) for end in span]}


def _plain(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _trial_columns(
    learner: Learner, nominal: Nominal, features: Features, trial: Trial, replicates: int
) -> Columns:
    """Measure one detector on one trial."""
    scored = learner.score(learner.bank(nominal), features, range(len(trial.frames)))
    label = np.asarray(trial.masks.any(axis=(1, 2)), np.bool_)
    drawn = image_weights(label, replicates, np.random.default_rng(0))
    weights = np.concatenate([np.ones((1, len(label))), drawn])
    pixel = pixel_measures(scored.maps, trial.masks, weights, _FALSE_ALARMS)
    return {
        "image_auroc": image_auroc_of(scored.scores, label, weights),
        "pixel_auroc": pixel.auroc,
        "pixel_auprc": pixel.average_precision,
        "aupro_fpr01": pixel.aupro,
    }


# The parameters for what a method reads and how much it keeps; the evaluation file has all of them.
_SHOWN = [
    "taps",
    "layers",
    "grid_tap",
    "channels",
    "dims",
    "rank",
    "neighbours",
    "block",
    "window_mm",
    "sigma",
]


def evaluation_tables(evaluation: Mapping[str, Any]) -> str:
    """Write a Markdown table per set: rows of backbone and detector, columns of measures with intervals."""
    text = [
        f"In brackets: 95 % intervals from {evaluation['replicates']} bootstrap replicates over presses, within each "
        "part. AU-PRO is integrated up to 1 % false positives.\n\nThe detectors' settings:\n",
    ]
    for method, chosen in evaluation["settings"].items():
        shown = (f"{name} {_short(chosen[name])}" for name in _SHOWN if chosen.get(name) is not None)
        text.append(f"- {method}: {', '.join(shown)}")
    for trial_set in evaluation["sets"].values():
        text.append(f"\n### {trial_set['title']}\n\n{trial_set['text']}\n")
        names = list(dict.fromkeys(name for row in trial_set["rows"] for name in row["measures"]))
        lines = [
            (row["backbone"], row["detector"], *(_interval(row["measures"].get(name)) for name in names))
            for row in trial_set["rows"]
        ]
        text.append(f"Trials: {', '.join(trial_set['trials'])}.\n")
        text.append(markdown_table(["backbone", "detector", *names], lines).rstrip())
    return "\n".join(text) + "\n"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "all"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _interval(measure: Mapping[str, Any] | None) -> str:
    if measure is None or measure["value"] is None:
        return "-"
    span = measure.get("over_images")
    return f"{measure['value']:.3f}" + (f" ({span[0]:.3f} to {span[1]:.3f})" if span else "")
