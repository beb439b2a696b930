"""Whether `gelgate fit` chooses the better trunk: the table of docs/detectors.md.

Run with `pytest tests/bench/test_trunk_choice.py -m bench -s`. Of each trial the choice, what each trunk showed of the
damage put into the nominal presses, and the truth: AU-PRO up to 1 % and image AUROC of the trial's own damaged presses,
that no choice sees. Each takes a minute of one core. With TRUNK_CHOICE_CACHE naming a folder each row is kept there;
TRUNK_CHOICE_METHODS names methods. Real trials need the folder of real frames.

The set of judgement, TRUNK_CHOICE_SET=judgement, was opened once, when everything was settled.
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

from calibration.benchmark.evaluation import scored_columns
from calibration.benchmark.presses import PARTS, development_trial, part_trial
from calibration.benchmark.real_touch import real_touch_trial
from calibration.benchmark.trial import PROFILE, Trial
from calibration.fitting.fit import FitConfig
from calibration.fitting.trunk_choice import choose_trunk
from calibration.fitting.trunks import DEFAULT_BACKBONE, OTHER_BACKBONES, open_trunk
from edge import registry
from edge.core.imaging.region import Region

pytestmark = pytest.mark.bench

KINDS = ("", "rendered damage", "pieces of relief")
METHODS = os.environ.get("TRUNK_CHOICE_METHODS", "padim,patchcore").split(",")
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


def trials(name: str, real_tactile: Path) -> Iterator[tuple[str, Callable[[], Trial]]]:
    if name == "development":
        yield from ((part, partial(part_trial, part)) for part in PARTS)
    yield from ((f"RP{number}", partial(development_trial, number)) for number in RANDOM[name])
    yield from ((one, partial(real_touch_trial, real_tactile, one)) for one in REAL[name])


def measured(trial: Trial, method: str) -> dict[str, Any]:
    """The choice for one trial as its presses lie, and the truth of every trunk."""
    detector = registry.detector(method)
    taps = detector.taps(detector.parameters("corrected"))
    height, width = trial.frames.shape[1:3]
    left, top = (PROFILE.size[0] - width) // 2, (PROFILE.size[1] - height) // 2
    region = Region(left, top, width, height)
    usual = open_trunk(DEFAULT_BACKBONE, taps)
    config = FitConfig("part", "top", PROFILE, region, detector, usual, threads=1, augment="auto")
    choice = choose_trunk(trial.nominal, config, OTHER_BACKBONES)
    graphs = {name: open_trunk(name, taps).graph for name in TRUNKS}
    truth = scored_columns(graphs, replace(trial, alpha=None), [method], 0)
    return {
        "chosen": choice.trunk.id,
        "found": choice.found,
        "truth": {
            name: [float(truth[name, method][measure][0]) for measure in ("aupro_fpr01", "image_auroc")]
            for name in TRUNKS
        },
    }


def rows(name: str, real_tactile: Path) -> list[dict[str, Any]]:
    """A row per trial and method; those in the cache are not measured again."""
    folder = os.environ.get("TRUNK_CHOICE_CACHE")
    file = Path(folder) / f"rows_{name}.jsonl" if folder else None
    found = [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []
    known = {(row["trial"], row["method"]) for row in found}
    for method in METHODS:
        for trial, make in trials(name, real_tactile):
            if (trial, method) not in known:
                found.append({"trial": trial, "method": method, **measured(make(), method)})
                if file:
                    with file.open("a") as out:
                        out.write(json.dumps(found[-1]) + "\n")
    return [row for row in found if row["method"] in METHODS]


def line(row: Mapping[str, Any]) -> str:
    seen = (f"{_seen(row['found'][trunk], ''):.3f}" for trunk in TRUNKS)
    truth = (" / ".join(f"{one:.3f}" for one in row["truth"][trunk]) for trunk in TRUNKS)
    lost = max(one[0] for one in row["truth"].values()) - row["truth"][row["chosen"]][0]
    return f"| {row['trial']} | {row['method']} | {' | '.join((*seen, row['chosen'], *truth))} | {lost:.3f} |"


def summary(found: Sequence[Mapping[str, Any]], method: str, kind: str = "") -> str:
    """Mean AU-PRO of the choice, of each trunk for all, and of the best of each trial. kind: chosen by this alone."""
    chosen = [row for row in found if row["method"] == method]
    area = np.array([[row["truth"][trunk][0] for trunk in TRUNKS] for row in chosen])
    seen = [[_seen(row["found"][trunk], kind) for trunk in TRUNKS] for row in chosen]
    picked = np.argmax(seen, axis=1)
    cells = [area[np.arange(len(area)), picked].mean(), *area.mean(axis=0), area.max(axis=1).mean()]
    right = int((area[np.arange(len(area)), picked] == area.max(axis=1)).sum())
    name = f"{method}, by {kind} alone" if kind else method
    return f"| {name} | {right} of {len(area)} | {' | '.join(f'{one:.3f}' for one in cells)} |"


def _seen(of: Mapping[str, float], kind: str) -> float:
    return of[kind] if kind else float(np.mean(list(of.values())))


def between_methods(found: Sequence[Mapping[str, Any]]) -> str:
    """Mean AU-PRO if the method were chosen too, by what it shows on its trunk; of each method; of the best of each."""
    by_trial: dict[str, dict[str, tuple[float, float]]] = {}
    for row in found:
        seen = _seen(row["found"][row["chosen"]], "")
        by_trial.setdefault(row["trial"], {})[row["method"]] = seen, row["truth"][row["chosen"]][0]
    kept = [of for of in by_trial.values() if len(of) == len(METHODS)]
    picked = [max(of.values())[1] for of in kept]
    each = [np.mean([of[method][1] for of in kept]) for method in METHODS]
    best = [max(truth for _, truth in of.values()) for of in kept]
    right = sum(one == most for one, most in zip(picked, best, strict=True))
    cells = " | ".join(f"{one:.3f}" for one in (np.mean(picked), *each, np.mean(best)))
    return f"| {right} of {len(kept)} | {cells} |"


def test_the_choice_against_the_truth(real_tactile: Path) -> None:
    """Prints the tables."""
    cv2.setNumThreads(1)
    found = rows(os.environ.get("TRUNK_CHOICE_SET", "development"), real_tactile)
    names = " | ".join(TRUNKS)
    print(f"\n| trial | method | seen: {names} | chosen | truth: {names} | lost |\n{'|---' * 8}|")
    print(*map(line, found), sep="\n")
    print(f"\n| method | right | chosen | {names} | best of each |\n{'|---' * 6}|")
    print(*(summary(found, method, kind) for method in METHODS for kind in KINDS), sep="\n")
    print(
        f"\n| right method | chosen | {' | '.join(METHODS)} | best of each |\n{'|---' * (3 + len(METHODS))}|"
    )
    print(between_methods(found))
    assert {row["chosen"] for row in found} <= set(TRUNKS)
