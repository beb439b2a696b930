"""Whether `gelgate fit` chooses the better method and trunk: the tables of docs/detectors.md.

Run with `pytest tests/bench/test_detection_choice.py -m bench -s`. Of each trial what every pair of a method and a
trunk showed of the damage put into the nominal presses, and the truth: AU-PRO up to 1 % and image AUROC of the trial's
own damaged presses, that no choice sees, scored by the fitted bundle. A pair takes a quarter of a minute of one core.
With DETECTION_CHOICE_CACHE naming a folder each row is kept there. Real trials need the folder of real frames.

The set of judgement is DETECTION_CHOICE_SET=judgement.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.experiments.backbones.presses import PARTS, development_trial, part_trial
from calibration.experiments.backbones.real_touch import real_touch_trial
from calibration.experiments.backbones.trial import PROFILE, Trial
from calibration.fitting.candidates import DEFAULT_METHOD, OTHER_METHODS, Candidates
from calibration.fitting.damage_seen import DamageJudge
from calibration.fitting.detection_choice import Comparison
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.trunks import DEFAULT_BACKBONE, OTHER_BACKBONES, open_trunk
from calibration.metrics import aupro, auroc
from edge import registry
from edge.core.errors import PoseNotFound
from edge.core.imaging.region import Region
from edge.model.scorer import Scorer

pytestmark = pytest.mark.bench

METHODS = (DEFAULT_METHOD, *OTHER_METHODS)
TRUNKS = (DEFAULT_BACKBONE, *OTHER_BACKBONES)
BALLS = ("ball 6.31 mm", "ball 9.47 mm")
REAL: Mapping[str, Sequence[str]] = {
    "development": (
        *(f"{ball}, {how}" for ball in BALLS for how in ("registered", "anywhere")),
        "finger on a marker gel",
    ),
    "judgement": ("ball 5.00 mm, registered", "ball 5.00 mm, anywhere", "ball 4.70 mm, anywhere"),
}
RANDOM: Mapping[str, Sequence[int]] = {"development": range(6), "judgement": range(20, 26)}
# Parts that a hand puts down, on which registration was developed.
ANYWHERE_PARTS, ANYWHERE_RANDOM = ("PZ1", "PZ3", "PZ5"), range(3)

Row = Mapping[str, Any]
Pair = tuple[str, str]


def trials(name: str, real_tactile: Path) -> Iterator[tuple[str, Callable[[], Trial]]]:
    if name == "development":
        yield from ((part, partial(part_trial, part)) for part in PARTS)
    yield from ((f"RP{number}", partial(development_trial, number)) for number in RANDOM[name])
    if name == "development":
        how = "parts anywhere"
        yield from ((f"{part} anywhere", partial(part_trial, part, how)) for part in ANYWHERE_PARTS)
        for number in ANYWHERE_RANDOM:
            yield f"RP{number} anywhere", partial(development_trial, number, condition=how)
    yield from ((one, partial(real_touch_trial, real_tactile, one)) for one in REAL[name])


def measured(trial: Trial, pairs: Sequence[Pair]) -> Iterator[dict[str, Any]]:
    """What each pair shows to a fit without options, and the truth."""
    height, width = trial.frames.shape[1:3]
    left, top = (PROFILE.size[0] - width) // 2, (PROFILE.size[1] - height) // 2
    region = Region(left, top, width, height)
    padim = registry.detector(DEFAULT_METHOD)
    usual = open_trunk(DEFAULT_BACKBONE, padim.taps(padim.parameters()))
    config = FitConfig(
        "part", "top", PROFILE, region, padim, usual, threads=1, register="auto", augment="auto"
    )
    judge = DamageJudge(trial.nominal, config)
    for method, trunk in pairs:
        comparison = Comparison(config, Candidates((method,), (trunk,)))
        comparison.run(judge, lambda stage, fraction: None)
        (seen,) = comparison.separations.values()
        truth = _truth(trial, replace(comparison.choose(), threshold=1.0))
        row = {"found": seen.by_kind, "truth": truth, "registered": seen.is_registered}
        yield {"method": method, "trunk": trunk, **row}


def _truth(trial: Trial, config: FitConfig) -> tuple[float | None, float | None]:
    """AU-PRO up to 1 % and image AUROC of the fitted bundle; a press without a pose scores 0."""
    scorer = Scorer(fit_files(trial.nominal, config, created="2026-01-01").bundle(), 1)
    frames, masks = trial.frames[trial.is_own], trial.masks[trial.is_own]
    maps, scores = np.zeros(masks.shape, np.float32), np.zeros(len(masks))
    for k, rgb in enumerate(frames):
        try:
            scored = scorer.score(rgb)
        except PoseNotFound:
            continue
        maps[k], scores[k] = scored.score_map, scored.anomaly_score
    return aupro(list(maps), list(masks)), auroc(scores, masks.any(axis=(1, 2)))


def rows(name: str, real_tactile: Path) -> list[dict[str, Any]]:
    """A row per trial, method and trunk; those in the cache are not measured again."""
    folder = os.environ.get("DETECTION_CHOICE_CACHE")
    file = Path(folder) / f"rows_{name}.jsonl" if folder else None
    found = [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []
    known = {(row["trial"], row["method"], row["trunk"]) for row in found}
    for trial, make in trials(name, real_tactile):
        pairs = [(method, trunk) for method in METHODS for trunk in TRUNKS]
        if missing := [pair for pair in pairs if (trial, *pair) not in known]:
            for row in measured(make(), missing):
                found.append({"trial": trial, **row})
                if file:
                    with file.open("a") as out:
                        out.write(json.dumps(found[-1]) + "\n")
    order = [trial for trial, _ in trials(name, real_tactile)]
    return sorted(found, key=lambda row: order.index(row["trial"]))


def by_trial(found: Sequence[Row]) -> dict[str, dict[Pair, Row]]:
    of: dict[str, dict[Pair, Row]] = {}
    for row in found:
        of.setdefault(row["trial"], {})[row["method"], row["trunk"]] = row
    return of


def picked(of: Mapping[Pair, Row], methods: Sequence[str] = METHODS) -> Pair:
    """The pair that shows most."""
    pairs = [(method, trunk) for trunk in TRUNKS for method in methods]
    return max(pairs, key=lambda pair: _seen(of[pair]))


def _seen(row: Row) -> float:
    return float(np.mean(list(row["found"].values())))


def line(trial: str, of: Mapping[Pair, Row]) -> str:
    """What each pair shows, and its truth; the choice, and the AU-PRO that is lost to the best pair."""
    pairs = [(method, trunk) for method in METHODS for trunk in TRUNKS]
    cells = []
    for pair in pairs:
        area, press = of[pair]["truth"]
        cells.append(f"{_seen(of[pair]):.3f}{'*' * of[pair]['registered']}: {area:.3f} / {press:.3f}")
    chosen = picked(of)
    lost = max(of[pair]["truth"][0] for pair in pairs) - of[chosen]["truth"][0]
    return f"| {trial} | {' | '.join(cells)} | {' on '.join(chosen)} | {lost:.3f} |"


def summary(found: Sequence[Row]) -> Iterator[str]:
    """Mean AU-PRO and image AUROC of each rule, and how often it takes the best pair of those it chooses from."""
    trials = list(by_trial(found).values())
    yield _rule("method and backbone chosen", trials, METHODS, picked)
    for method in METHODS:
        yield _rule(f"{method}, backbone chosen", trials, [method], lambda of, m=method: picked(of, [m]))
        for trunk in TRUNKS:
            yield _rule(f"{method} on {trunk}", trials, [method], lambda of, pair=(method, trunk): pair)
    yield _rule(
        "the best of each trial",
        trials,
        METHODS,
        lambda of: max(of, key=lambda pair: of[pair]["truth"][0]),
    )


def _rule(
    name: str,
    trials: Sequence[Mapping[Pair, Row]],
    methods: Sequence[str],
    pick: Callable[[Mapping[Pair, Row]], Pair],
) -> str:
    taken = [of[pick(of)]["truth"] for of in trials]
    is_real = [next(iter(of.values()))["trial"].startswith(("ball", "finger")) for of in trials]
    best = [max(row["truth"][0] for (method, _), row in of.items() if method in methods) for of in trials]
    right = sum(one[0] == most for one, most in zip(taken, best, strict=True))
    lost = max(most - one[0] for one, most in zip(taken, best, strict=True))
    area, press = np.mean(taken, axis=0)
    real = " / ".join(f"{one:.3f}" for one in np.mean(np.array(taken)[is_real], axis=0))
    return f"| {name} | {area:.3f} / {press:.3f} | {real} | {right} of {len(trials)} | {lost:.3f} |"


def test_the_choice_against_the_truth(real_tactile: Path) -> None:
    """Prints the tables."""
    cv2.setNumThreads(1)
    found = rows(os.environ.get("DETECTION_CHOICE_SET", "development"), real_tactile)
    pairs = " | ".join(f"{method}, {trunk}" for method in METHODS for trunk in TRUNKS)
    print(f"\n| trial | {pairs} | chosen | lost |\n{'|---' * 7}|")
    print(*(line(trial, of) for trial, of in by_trial(found).items()), sep="\n")
    print("\n| rule | AU-PRO / image AUROC | real touch alone | best of its choices | largest loss |")
    print("|---|---|---|---|---|")
    print(*summary(found), sep="\n")
    assert {picked(of)[0] for of in by_trial(found).values()} <= set(METHODS)
