"""Short trunks of an ablation: the trials that read them, and their rows, which an interrupted run continues."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.benchmark.evaluation import scored_columns
from calibration.benchmark.presses import development_trial
from calibration.benchmark.real_touch import real_touch_trial
from calibration.benchmark.trial import Trial
from calibration.training.train_config import TrainConfig
from edge.core.errors import ConfigError, GelgateError
from edge.core.suggest import suggestion
from edge.model.onnx_prune import cut_trunk
from plugins.backbones.resnet import build_trunk

if TYPE_CHECKING:
    from calibration.training.train import Lesson

__all__ = [
    "ShortTrunk",
    "TrialReading",
    "about",
    "arguments",
    "chosen",
    "complete",
    "exit_code",
    "mean_of",
    "opened",
    "read",
    "readings",
    "rows_of",
    "trained",
]

_BOTH = ("padim", "patchcore")
_TAP = "layer1"


@dataclass(frozen=True)
class TrialReading:
    """A trial and the methods that read it. is_real: presses of a real sensor."""

    name: str
    make: Callable[[], Trial]
    methods: tuple[str, ...] = _BOTH
    is_real: bool = True


@dataclass(frozen=True)
class ShortTrunk:
    """One row: the variant and the seed of a trunk, what it was made with, and how to find what it is worth."""

    variant: str
    seed: int
    about: Mapping[str, Any]
    measure: Callable[[], Mapping[str, Any]]


def readings(data: Path) -> list[TrialReading]:
    """The trials of the comparison. data: the folder of real tactile frames.

    PaDiM compares place by place and says nothing of presses that lie anywhere. Errors: ConfigError for no folder.
    """
    if not data.is_dir():
        raise ConfigError(f"'{data}' is no folder of real tactile frames; name it with --tactile")
    real = partial(partial, real_touch_trial, data)
    return [
        *(
            TrialReading(name, real(name))
            for name in ("ball 6.31 mm, registered", "ball 9.47 mm, registered")
        ),
        TrialReading("ball 6.31 mm, anywhere", real("ball 6.31 mm, anywhere"), ("patchcore",)),
        TrialReading("finger on a marker gel", real("finger on a marker gel")),
        TrialReading("RP0", partial(development_trial, 0), is_real=False),
    ]


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The lines of an earlier run, none without a file; half a line at the end is left out. Errors: ConfigError."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    try:
        return [json.loads(line) for line in lines if line.endswith("\n")]
    except json.JSONDecodeError as error:
        raise ConfigError(f"'{path}' is damaged: {error}; remove it or choose another folder") from error


def mean_of(row: Mapping[str, Any], is_real: bool, column: str = "aupro_fpr01") -> float:
    """Of a row, over the real or the simulated trials, of the mean over the methods of each."""
    chosen = [found for name, found in row[column].items() if (name in row["real"]) == is_real]
    return float(np.mean([np.mean(list(found.values())) for found in chosen]))


def complete(
    path: Path, column: str, planned: Iterable[ShortTrunk], say: Callable[[str], None] = print
) -> list[dict[str, Any]]:
    """Measure the planned trunks that have no row yet; every row of the file.

    column: of the variant's name. Errors: ConfigError for a file with rows of another recipe or other trials.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = rows_of(path)
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    made = {(row[column], row["seed"]): row for row in rows if column in row}
    for trunk in planned:
        if (trunk.variant, trunk.seed) in made:
            _check_equal(made[trunk.variant, trunk.seed], trunk.about, path)
            continue
        measured = trunk.measure()
        rows.append({column: trunk.variant, "seed": trunk.seed, **trunk.about, **measured})
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        say(f"{trunk.variant}, seed {trunk.seed}: {measured}")
    return rows


def about(
    recipe: TrainConfig, trials: Sequence[TrialReading], varied: Sequence[str] = ("seed",)
) -> dict[str, Any]:
    """What the trunks of one comparison have in common. varied: settings in which they differ."""
    return {
        "recipe": {k: v for k, v in json.loads(recipe.to_json()).items() if k not in varied},
        "real": [trial.name for trial in trials if trial.is_real],
    }


def _check_equal(row: Mapping[str, Any], wanted: Mapping[str, Any], path: Path) -> None:
    for key, value in wanted.items():
        if row[key] != value:
            raise ConfigError(
                f"'{path}' has rows of another {key} ({row[key]}, not {value}); choose another folder"
            )


def trained(runs: Path, variant: str, recipe: TrainConfig, lesson: "Lesson | None" = None) -> bytes:
    """The trunk of one variant up to layer1; an interrupted training is continued. lesson: None for the recipe's."""
    from calibration.training.checkpoint import latest, load
    from calibration.training.package import trunk_state
    from calibration.training.train import Lesson, TrainingRun, train

    folder = runs / f"{variant.replace(' ', '_')}_{recipe.seed}"
    resume = folder if latest(folder) else None
    run = TrainingRun(folder, resume=resume, save_every=100, threads=1, device="cpu")
    train(recipe, run, lesson=lesson or Lesson())
    return build_trunk(trunk_state(load(folder).weights), "resnet18", (_TAP,))


def opened() -> Callable[[TrialReading], Trial]:
    """Makes each trial once, without a fitted limit."""
    return cache(lambda reading: replace(reading.make(), alpha=None))


def read(
    graph: bytes, trials: Sequence[TrialReading], open_trial: Callable[[TrialReading], Trial]
) -> dict[str, dict[str, float]]:
    """AU-PRO up to 1 % false alarms by trial and method."""
    trunk = {"": cut_trunk(graph, (_TAP,))}
    return {
        of.name: {
            method: round(float(columns["aupro_fpr01"][0]), 5)
            for (_, method), columns in scored_columns(trunk, open_trial(of), of.methods, 0).items()
        }
        for of in trials
    }


def arguments(prog: str, description: str, seeds: str, only: tuple[str, str]) -> argparse.ArgumentParser:
    """The arguments of an ablation. seeds: what --seeds means. only: what --only names, and what it means."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("out", type=Path, help="output folder; an interrupted run in it is continued")
    parser.add_argument("--tactile", type=Path, required=True, help="folder of real tactile frames")
    parser.add_argument("--seeds", type=int, default=1, help=seeds)
    parser.add_argument("--only", action="append", default=[], metavar=only[0], help=only[1])
    parser.add_argument("--steps", type=int, default=120, help="optimiser steps of each trunk")
    parser.add_argument("--pairs", type=int, default=8, help="pairs of frames per step")
    parser.add_argument("--side", type=int, default=96, help="pixels per side of a frame")
    return parser


def chosen(only: Sequence[str], known: Iterable[str], base: str, what: str) -> list[str]:
    """All that are known, or the base and those of these names. what: a name's kind. Errors: ConfigError."""
    names = list(known)
    for name in only:
        if name not in names:
            raise ConfigError(f"no {what} is named '{name}'; {suggestion(name, names)}")
    return [name for name in names if not only or name in (base, *only)]


def exit_code(work: Callable[[], None]) -> int:
    """Do the work of a command; 0 when done, 3 after the sentence of what is wrong."""
    try:
        work()
    except (GelgateError, OSError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0
