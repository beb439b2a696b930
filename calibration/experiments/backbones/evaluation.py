"""Compares backbones: the same detectors, presses and measures on trunks with different weights."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import call
from typing import Any

import cv2
import numpy as np

from calibration.experiments.backbones.sets import FORMAT, PROFILE, EvaluationSet, Trial
from calibration.experiments.harness.markdown import markdown_table
from calibration.fitting.damage.damaged_presses import render_damage
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, ShownPresses, TapReader, score_held_out
from calibration.fitting.limits.limit_choice import Evidence, choose_limit
from calibration.fitting.limits.map_limit import relate
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.metrics import image_weights, interval, pixel_measures
from calibration.metrics.summary import image_auroc_of
from calibration.simulator.workers import in_order
from edge import registry
from edge.core.arrays import F32, F64, U8, Mask
from edge.core.detector import Bank, Features, Nominal
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region
from edge.core.verdict import Kind, decide
from edge.model.graph_cut import cut_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

__all__ = [
    "RANDOM",
    "evaluate",
    "evaluation_tables",
    "is_on_damage",
    "limit_columns",
    "random_trunk",
    "used_settings",
]

RANDOM = "random"
"""The name of the column with random weights."""

PEAK_PX = 6
"""How far from the damage a map's peak may lie: one and a half cells of the finest tap."""

_FALSE_ALARMS, _MORE_FALSE_ALARMS = 0.01, 0.05

Maps = F32

Column = F64
"""One measure: its value, then one value per bootstrap replicate."""

Columns = dict[str, Column]
Take = Callable[[U8], Features]


def random_trunk() -> bytes:
    """Make a ResNet-18 with random weights, seed 0: what training is compared with."""
    return build_trunk(random_state("resnet18"), "resnet18")


def used_settings(method: str) -> dict[str, Any]:
    """Return every parameter of the method."""
    return dict(vars(registry.detector(method).parameters()))


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
    Brief sets compare the first trunk and `random` alone. Where a trial states a false-alarm rate, it is measured at
    the fitted limit too; that fits each detector six times. advance: called with the trials done.
    """
    shallow = {name: cut_trunk(graph, _taps(detectors)) for name, graph in trunks.items()}
    brief = {name: graph for name, graph in shallow.items() if name in (next(iter(shallow)), RANDOM)}
    tasks = [
        partial(_measure, make, brief if chosen.is_brief else shallow, detectors, replicates)
        for chosen in sets.values()
        for make in chosen.trials
    ]
    found = []
    for measured in in_order(call, tasks, workers):
        found.append(measured)
        advance(len(found))
    results = iter(found)
    return {
        "format": FORMAT,
        "replicates": replicates,
        "settings": {method: used_settings(method) for method in detectors},
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
            scored[trunk, method] = _trial_columns(learner, nominal, features, trial, reader.take, replicates)
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
        # Not every trial has presses of another object.
        measures = dict.fromkeys(measure for own in columns.values() for measure in own)
        rows.append(
            {
                "backbone": trunk,
                "detector": method,
                "measures": {name: _mean(columns.values(), name) for name in measures},
                "trials": {
                    trial: {name: _plain(column[0]) for name, column in own.items()}
                    for trial, own in columns.items()
                },
            }
        )
    return {"title": of.title, "text": of.text, "trials": [name for name, _ in trials], "rows": rows}


def _mean(trials: Iterable[Columns], name: str) -> dict[str, Any]:
    column = np.mean([own[name] for own in trials if name in own], axis=0)
    span = interval(column[1:]) if len(column) > 1 else None
    return {"value": _plain(column[0]), "over_images": span and [_plain(end) for end in span]}


def _plain(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _trial_columns(
    learner: Learner, nominal: Nominal, features: Features, trial: Trial, take: Take, replicates: int
) -> Columns:
    """Measure one detector on one trial.

    Where the trial states a false-alarm rate, AU-PRO up to 5 % and the measures at the fitted limit are added. take:
    the features of further frames, every tap.
    """
    bank = learner.bank(nominal)
    raw = learner.score(bank, features, range(len(trial.frames)))
    own, masks = trial.is_own, trial.masks[trial.is_own]
    label = np.asarray(masks.any(axis=(1, 2)), np.bool_)
    drawn = image_weights(label, replicates, np.random.default_rng(0))
    weights = np.concatenate([np.ones((1, len(label))), drawn])

    def describe(maps: Maps, scores: F64) -> Columns:
        pixel = pixel_measures(maps[own], masks, weights, _FALSE_ALARMS)
        return {
            "image_auroc": image_auroc_of(scores[own], label, weights),
            "pixel_auroc": pixel.auroc,
            "pixel_auprc": pixel.average_precision,
            "aupro_fpr01": pixel.aupro,
        }

    if trial.alpha is None:
        return describe(raw.maps, raw.scores)
    plain_limit, to_limit = _fit_limit(learner, bank, nominal, trial, trial.alpha, take)
    maps, scores, limit = raw.maps, raw.scores, plain_limit
    if to_limit is not None:  # as a bundle publishes them
        maps = np.stack([to_limit(one[None])[0] for one in raw.maps]).astype(np.float32)
        scores, limit = np.asarray(maps.max(axis=(1, 2)), np.float64), 1.0
    plain = limit_columns(plain_limit, trial, raw.maps, raw.scores, weights)
    return {
        **describe(maps, scores),
        "aupro_fpr05": pixel_measures(maps[own], masks, weights, _MORE_FALSE_ALARMS).aupro,
        **limit_columns(limit, trial, maps, scores, weights),
        **{f"plain_{name}": plain[name] for name in ("detected", "peak_found", "false_alarms")},
        "plain_aupro_fpr01": pixel_measures(raw.maps[own], masks, weights, _FALSE_ALARMS).aupro,
    }


def _fit_limit(
    learner: Learner, bank: Bank, nominal: Nominal, trial: Trial, alpha: float, take: Take
) -> tuple[float, Callable[[Maps], F64] | None]:
    """Fit limits of these presses as `gelgate fit` does without options; their features are not taken again.

    Returns that of the raw scores, and what relates maps to another limit if a fit would choose it. Errors: FitError.
    """
    specimens = trial.nominal.specimens or (None,) * len(trial.nominal)
    folds, _ = divide_presses(specimens, FitConfig.folds, np.random.default_rng(FitConfig.seed))
    height, width = trial.frames.shape[1:3]
    region = Region((PROFILE.size[0] - width) // 2, (PROFILE.size[1] - height) // 2, width, height)
    damage = render_damage(trial.nominal, PROFILE, region, np.random.default_rng(FitConfig.seed))
    edited = None if damage is None else (ShownPresses(take(damage.frames)), damage.press)
    held_out = score_held_out(learner, nominal, folds, edited)
    plain = conformal_threshold(held_out.sound.scores, alpha, specimens=specimens).value
    if damage is None:
        return plain, None
    evidence = Evidence(
        held_out,
        learner.score(bank, nominal.features, range(nominal.presses)),
        None,  # a black frame is refused for its colours
        damage,
        folds,
        specimens,
        alpha,
        learner.grid.pixels_per_mm,
    )
    other = choose_limit(evidence).other
    return plain, None if other is None else partial(relate, other.limit)


def is_on_damage(maps: Maps, masks: Mask) -> Mask:
    """Say whether the largest value of each map lies on its mask or near it, bool (n,); False for an empty mask."""
    return np.array([_is_near(one, mask) for one, mask in zip(maps, masks, strict=True)], np.bool_)


def _is_near(one: Maps, mask: Mask) -> bool:
    row, column = np.unravel_index(int(one.argmax()), one.shape)
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool(away[row, column] <= PEAK_PX)


def limit_columns(limit: float, trial: Trial, maps: Maps, scores: F64, weights: F64) -> Columns:
    """Count shares of the trial's frames at a limit, each (weightings,).

    weights: float64 (weightings, own presses). `detected` and `peak_found` are shares of the edits, `false_alarms` of
    the held-out presses, `relit_alarms` of those under another light; `others_detected` and `others_auroc`, presses of
    another object against the held-out ones, are added where there are some. Without weights of their own, the last
    three have no interval.
    """
    is_fail = np.array([decide(float(score), limit).kind is Kind.FAIL for score in scores], np.bool_)
    own = trial.is_own
    damaged: Mask = np.asarray(trial.masks[own].any(axis=(1, 2)), np.bool_)

    def share(flags: Mask, chosen: Mask) -> F64:
        of = weights[:, chosen]
        return np.asarray((of @ flags[chosen]) / of.sum(axis=1), np.float64)

    def alone(value: float) -> F64:
        return np.concatenate([[value], np.full(len(weights) - 1, np.nan)])

    columns = {
        "detected": share(is_fail[own], damaged),
        "peak_found": share(is_on_damage(maps[own], trial.masks[own]), damaged),
        "false_alarms": share(is_fail[own], ~damaged),
    }
    if trial.is_relit is not None and trial.is_relit.any():
        columns["relit_alarms"] = alone(is_fail[trial.is_relit].mean())
    if trial.is_other is not None and trial.is_other.any():
        others, sound = scores[trial.is_other], scores[own][~damaged]
        right = (others[:, None] > sound) + 0.5 * (others[:, None] == sound)
        columns["others_detected"] = alone(is_fail[trial.is_other].mean())
        columns["others_auroc"] = alone(right.mean())
    return columns


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
    for found in evaluation["sets"].values():
        text.append(f"\n### {found['title']}\n\n{found['text']}\n")
        names = list(dict.fromkeys(name for row in found["rows"] for name in row["measures"]))
        lines = [
            (row["backbone"], row["detector"], *(_interval(row["measures"].get(name)) for name in names))
            for row in found["rows"]
        ]
        text.append(f"Trials: {', '.join(found['trials'])}.\n")
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
