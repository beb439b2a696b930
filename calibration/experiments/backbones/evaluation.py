"""Compares backbones: the same detectors, presses and measures on trunks with different weights."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.experiments.backbones.sets import EvaluationSet
from calibration.experiments.backbones.trial import FORMAT, PROFILE, Trial
from calibration.fitting.damage.damaged_presses import render_damage
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, score_held_out
from calibration.fitting.limits.limit_choice import Choice, Evidence, choose_limit
from calibration.fitting.limits.map_limit import PLAIN, relate
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.scatter import is_placed
from calibration.fitting.tap_reader import TapReader
from calibration.metrics import image_weights, interval, pixel_measures
from calibration.metrics.summary import image_auroc_of
from calibration.simulator.workers import in_order
from edge import registry
from edge.core.detector import Bank, Features, Nominal
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region
from edge.core.verdict import Kind, decide
from edge.model.graph_cut import cut_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

__all__ = [
    "PEAK_PX",
    "RANDOM",
    "Column",
    "FittedLimits",
    "default_detectors",
    "evaluate",
    "fit_limits",
    "is_on_damage",
    "limit_columns",
    "random_trunk",
    "score_columns",
    "trial_columns",
    "used_settings",
]

RANDOM = "random"
"""The name of the column with random weights."""

_MEASURES = ("image_auroc", "pixel_auroc", "pixel_auprc", "aupro_fpr01")
_FALSE_ALARMS, _MORE_FALSE_ALARMS = 0.01, 0.05
_THREADS = 1

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
U8 = NDArray[np.uint8]

Column = Float
"""One measure: its value, then one value per bootstrap replicate."""

Scored = dict[tuple[str, str], dict[str, Column]]
"""(backbone, detector) to the measures of one trial."""


def default_detectors() -> list[str]:
    """The detectors that backbones are compared with by default: every installed one that is no baseline."""
    return [name for name in registry.names("detectors") if not registry.detector(name).is_baseline]


def random_trunk() -> bytes:
    """A ResNet-18 with random weights, seed 0: what training is compared with."""
    return build_trunk(random_state("resnet18"), "resnet18")


@dataclass(frozen=True)
class _Task:
    """One trial of a set with the trunks to compare on it."""

    make: Callable[[], Trial]
    trunks: Mapping[str, bytes]
    detectors: Sequence[str]
    replicates: int
    limits: bool


def evaluate(
    trunks: Mapping[str, bytes],
    sets: Mapping[str, EvaluationSet],
    detectors: Sequence[str],
    *,
    replicates: int = 200,
    limits: bool = True,
    workers: int = 1,
    say: Callable[[str], None] = lambda _: None,
    advance: Callable[[int], None] = lambda done: None,
) -> dict[str, Any]:
    """Measure one row per set, trunk and detector: the mean of each measure over the set's trials, with 95 % intervals.

    trunks: name to graph, the one that ships first. The intervals are bootstrapped over presses, within each trial.
    Brief sets compare the first trunk and `random` alone. limits: measure at the fitted limit too where a trial states
    a false-alarm rate; that fits each detector six times instead of once. advance: called with the trials done.
    """
    tasks = list(_tasks(trunks, sets, detectors, replicates, limits))
    results = in_order(_run, [task for _, task in tasks], workers)
    found: dict[str, list[tuple[str, Scored]]] = {name: [] for name in sets}
    for done, ((name, _), (trial, scored)) in enumerate(zip(tasks, results, strict=True), start=1):
        found[name].append((trial, scored))
        for (trunk, method), columns in scored.items():
            first = ", ".join(f"{measure} {column[0]:.3f}" for measure, column in columns.items())
            say(f"{name} / {trial} / {trunk} / {method}: {first}")
        advance(done)
    return {
        "format": FORMAT,
        "replicates": replicates,
        "settings": {method: used_settings(method) for method in detectors},
        "sets": {name: _write_set(sets[name], trials) for name, trials in found.items()},
    }


def _tasks(
    trunks: Mapping[str, bytes],
    sets: Mapping[str, EvaluationSet],
    detectors: Sequence[str],
    replicates: int,
    limits: bool,
) -> Iterator[tuple[str, _Task]]:
    taps = _taps(detectors)
    shallow = {name: cut_trunk(graph, taps) for name, graph in trunks.items()}
    first = next(iter(shallow))
    brief = {name: graph for name, graph in shallow.items() if name in (first, RANDOM)}
    for name, chosen in sets.items():
        for make in chosen.trials:
            yield name, _Task(make, brief if chosen.is_brief else shallow, detectors, replicates, limits)


def _run(task: _Task) -> tuple[str, Scored]:
    """Measure one trial: its name and measures; runs in any process."""
    trial = task.make()
    trial = trial if task.limits else replace(trial, alpha=None)
    return trial.name, score_columns(task.trunks, trial, task.detectors, task.replicates)


def score_columns(
    trunks: Mapping[str, bytes], trial: Trial, detectors: Sequence[str], replicates: int
) -> Scored:
    """The measures of every trunk with every detector on one trial."""
    scored: Scored = {}
    for trunk, graph in trunks.items():
        reader = TapReader(graph, _taps(detectors), trial.frames.shape[1:3], LR_PIXELS_PER_MM, _THREADS)
        nominal, features = reader.nominal(trial.nominal), reader.take(trial.frames)
        for method in detectors:
            learner = reader.learner(registry.detector(method))
            scored[trunk, method] = trial_columns(learner, nominal, features, trial, reader.take, replicates)
    return scored


def _taps(detectors: Sequence[str]) -> tuple[str, ...]:
    """Every tap that one of the detectors reads."""
    loaded = [registry.detector(method) for method in detectors]
    return tuple(sorted({tap for detector in loaded for tap in detector.taps(detector.parameters())}))


def used_settings(method: str) -> dict[str, Any]:
    """Every parameter of the method."""
    return dict(vars(registry.detector(method).parameters()))


def _write_set(of: EvaluationSet, trials: Sequence[tuple[str, Scored]]) -> dict[str, Any]:
    if not trials:
        return {"title": of.title, "text": of.text, "missing": of.missing}
    pairs = list(trials[0][1])
    return {
        "title": of.title,
        "text": of.text,
        "trials": [name for name, _ in trials],
        "rows": [_row(*pair, [(name, scored[pair]) for name, scored in trials]) for pair in pairs],
    }


def _row(trunk: str, method: str, trials: Sequence[tuple[str, dict[str, Column]]]) -> dict[str, Any]:
    columns = [column for _, column in trials]
    # Not every trial has presses of another object.
    names = dict.fromkeys(name for column in columns for name in column)
    return {
        "backbone": trunk,
        "detector": method,
        "measures": {name: _mean(columns, name) for name in names},
        "trials": {trial: {name: _plain(column[0]) for name, column in row.items()} for trial, row in trials},
    }


def _mean(rows: Sequence[dict[str, Column]], name: str) -> dict[str, Any]:
    column = np.mean([row[name] for row in rows if name in row], axis=0)
    span = interval(column[1:]) if len(column) > 1 else None
    return {
        "value": _plain(column[0]),
        "over_images": None if span is None else [_plain(end) for end in span],
    }


def _plain(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def trial_columns(
    learner: Learner,
    nominal: Nominal,
    features: Features,
    trial: Trial,
    take: Callable[[U8], Features],
    replicates: int,
) -> dict[str, Column]:
    """Measure one detector on one trial.

    Where the trial states a false-alarm rate, AU-PRO up to 5 % and the measures at the fitted limit are added. take:
    the features of further frames, every tap.
    """
    bank = learner.bank(nominal)
    scored = learner.score(bank, features, range(len(trial.frames)))
    maps, scores, limit = scored.maps, scored.scores, 0.0
    if trial.alpha is not None:
        limits = fit_limits(learner, bank, nominal, trial, take)
        maps, scores, limit = limits.applied(maps, scores)
    own = trial.is_own
    masks = trial.masks[own]
    label = np.array([bool(mask.any()) for mask in masks])
    drawn = image_weights(label, replicates, np.random.default_rng(0))
    weights = np.concatenate([np.ones((1, len(label))), drawn])
    pixel = pixel_measures(maps[own], masks, weights, _FALSE_ALARMS)
    values = (
        image_auroc_of(scores[own], label, weights),
        pixel.auroc,
        pixel.average_precision,
        pixel.aupro,
    )
    columns = dict(zip(_MEASURES, values, strict=True))
    if trial.alpha is not None:
        more = pixel_measures(maps[own], masks, weights, _MORE_FALSE_ALARMS)
        columns["aupro_fpr05"] = more.aupro
        columns |= limit_columns(limit, trial, maps, scores, weights)
        plain = limit_columns(limits.plain, trial, scored.maps, scored.scores, weights)
        columns |= {f"plain_{name}": plain[name] for name in ("detected", "peak_found", "false_alarms")}
        columns["plain_aupro_fpr01"] = pixel_measures(scored.maps[own], masks, weights, _FALSE_ALARMS).aupro
    return columns


PEAK_PX = 6
"""How far from the damage a map's peak may lie: one and a half cells of the finest tap."""

# As `gelgate fit` does without options.
_FOLDS, _SEED = FitConfig.folds, FitConfig.seed


@dataclass(frozen=True, eq=False)
class FittedLimits:
    """plain: the limit of the raw scores. choice: what a fit would choose instead, if anything."""

    plain: float
    choice: Choice

    def applied(self, maps: NDArray[np.float32], scores: Float) -> tuple[NDArray[np.float32], Float, float]:
        """Raw maps (n, h, w) and scores (n,) as a bundle publishes them, and its limit."""
        if self.choice.other is None:
            return maps, scores, self.plain
        relative = [relate(self.choice.other.limit, one[None])[0] for one in maps]
        published = np.stack(relative).astype(np.float32)
        return published, np.asarray(published.max(axis=(1, 2)), np.float64), 1.0


def fit_limits(
    learner: Learner, bank: Bank, nominal: Nominal, trial: Trial, take: Callable[[U8], Features]
) -> FittedLimits:
    """The limits that a fit of these presses would set; their features are not taken again.

    take: the features of frames. Errors: FitError; ValueError for a trial without a false-alarm rate.
    """
    if trial.alpha is None:
        raise ValueError(f"the trial '{trial.name}' states no false-alarm rate")
    specimens = trial.nominal.specimens or (None,) * len(trial.nominal)
    folds, _ = divide_presses(specimens, _FOLDS, np.random.default_rng(_SEED))
    height, width = trial.frames.shape[1:3]
    region = Region((PROFILE.size[0] - width) // 2, (PROFILE.size[1] - height) // 2, width, height)
    damage = render_damage(trial.nominal, PROFILE, region, np.random.default_rng(_SEED))
    edited = None if damage is None else (take(damage.frames), damage.press)
    held_out = score_held_out(learner, nominal, folds, edited)
    plain = conformal_threshold(held_out.sound.scores, trial.alpha, specimens=specimens).value
    if damage is None:
        return FittedLimits(plain, Choice(PLAIN, "no damage can be rendered"))
    known = learner.score(bank, nominal.features, range(nominal.presses))
    evidence = Evidence(
        held_out,
        known,
        None,  # a black frame is refused for its colours
        damage,
        folds,
        specimens,
        trial.alpha,
        learner.grid.pixels_per_mm,
        is_placed(trial.nominal, PROFILE),
    )
    return FittedLimits(plain, choose_limit(evidence))


def is_on_damage(maps: NDArray[np.float32], masks: Mask) -> Mask:
    """Say whether the largest value of each map lies on its mask or near it, bool (n,); False for an empty mask."""
    return np.array([_is_near(one, mask) for one, mask in zip(maps, masks, strict=True)], np.bool_)


def _is_near(one: NDArray[np.float32], mask: Mask) -> bool:
    row, column = np.unravel_index(int(one.argmax()), one.shape)
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool(away[row, column] <= PEAK_PX)


def limit_columns(
    limit: float, trial: Trial, maps: NDArray[np.float32], scores: Float, weights: Float
) -> dict[str, Float]:
    """Shares of the trial's frames at a limit, each (weightings,).

    weights: float64 (weightings, own presses). `detected` and `peak_found` are shares of the edits, `false_alarms` of
    the held-out presses, `relit_alarms` of those under another light; `others_detected` and `others_auroc`, presses of
    another object against the held-out ones, are added where there are some. Without weights of their own, the last
    three have no interval.
    """
    is_fail, own = _is_fail(scores, limit), trial.is_own
    damaged: Mask = np.asarray(trial.masks[own].any(axis=(1, 2)), np.bool_)
    columns = {
        "detected": _share(is_fail[own], damaged, weights),
        "peak_found": _share(is_on_damage(maps[own], trial.masks[own]), damaged, weights),
        "false_alarms": _share(is_fail[own], ~damaged, weights),
    }
    if trial.is_relit is not None and trial.is_relit.any():
        columns["relit_alarms"] = _alone(is_fail[trial.is_relit].mean(), len(weights))
    if trial.is_other is not None and trial.is_other.any():
        others, sound = scores[trial.is_other], scores[own][~damaged]
        right = (others[:, None] > sound) + 0.5 * (others[:, None] == sound)
        columns["others_detected"] = _alone(is_fail[trial.is_other].mean(), len(weights))
        columns["others_auroc"] = _alone(right.mean(), len(weights))
    return columns


def _is_fail(scores: Float, limit: float) -> Mask:
    return np.array([decide(float(score), limit).kind is Kind.FAIL for score in scores], np.bool_)


def _share(flags: Mask, chosen: Mask, weights: Float) -> Float:
    """The weighted share of the chosen presses that are flagged, (weightings,)."""
    of = weights[:, chosen]
    return np.asarray((of @ flags[chosen]) / of.sum(axis=1), np.float64)


def _alone(value: float, weightings: int) -> Float:
    return np.concatenate([[value], np.full(weightings - 1, np.nan)])
