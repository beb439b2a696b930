"""What each effect of the simulator is worth: short trunks, each learnt from presses without one effect.

    python -m calibration.benchmark.effect_ablation OUT --tactile REAL_TACTILE

trains layer1 of the tactile trunk for some steps, with every effect that training draws, without each of them, and
without all effects of light and camera, everything else equal, for every seed. PaDiM and PatchCore read each trunk on
real presses with small edits and on a simulated part, of the development sets of `evaluate-backbone`.
`OUT/effects.jsonl` has a line for each trunk and one with the effects' processor times; the same command continues an
interrupted run. `calibration.benchmark.effect_table` prints the table of docs/simulator.md and holds its rule.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from calibration.benchmark.effect_costs import effect_costs
from calibration.benchmark.evaluation import random_trunk, scored_columns
from calibration.benchmark.presses import development_trial
from calibration.benchmark.real_touch import real_touch_trial
from calibration.benchmark.trial import Trial
from calibration.simulator.effects import EFFECTS as SIMULATED
from calibration.training.train_config import EFFECTS, TrainConfig
from edge.core.errors import ConfigError, GelgateError
from edge.core.suggest import suggestion
from edge.model.onnx_prune import cut_trunk
from plugins.backbones.resnet import build_trunk

__all__ = [
    "ALL",
    "NOT_TRAINED",
    "OPTICAL",
    "ROWS",
    "VARIANTS",
    "TrialReading",
    "ablate",
    "measure_costs",
    "readings",
    "rows_of",
]

ROWS = "effects.jsonl"
ALL, OPTICAL, NOT_TRAINED = "all effects", "no effect of light and camera", "random weights"
VARIANTS: Mapping[str, tuple[str, ...]] = {
    ALL: EFFECTS,
    **{name: tuple(other for other in EFFECTS if other != name) for name in EFFECTS},
    OPTICAL: tuple(name for name in EFFECTS if SIMULATED[name].stage not in ("light", "camera")),
}
"""Of each trunk, the effects that its presses have; under an effect's name those without it."""

_BOTH = ("padim", "patchcore")
_MORE_SEEDS = 3
_TAP = "layer1"


@dataclass(frozen=True)
class TrialReading:
    """A trial and the methods that read it. is_real: presses of a real sensor."""

    name: str
    make: Callable[[], Trial]
    methods: tuple[str, ...] = _BOTH
    is_real: bool = True


def readings(data: Path) -> list[TrialReading]:
    """The trials of the comparison. data: the folder of real tactile frames.

    PaDiM compares place by place and says nothing of presses that lie anywhere.
    """
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


def ablate(
    out: Path,
    recipe: TrainConfig,
    seeds: int,
    trials: Sequence[TrialReading],
    variants: Mapping[str, tuple[str, ...]] = VARIANTS,
    say: Callable[[str], None] = print,
) -> list[dict[str, Any]]:
    """Train and read what is not yet in `OUT/effects.jsonl`; every row.

    recipe: of every trunk, but for seed and effects. seeds: trunks of each kind; of those with every effect, which all
    others are compared with, three more. Errors: ConfigError for a folder with rows of another recipe or
    other trials.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / ROWS
    rows = rows_of(path)
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    made = {(row["without"], row["seed"]): row for row in rows if "without" in row}
    open_trial = cache(lambda reading: replace(reading.make(), alpha=None))
    for name, seed, wanted in _planned(recipe, seeds, variants):
        about = _about(wanted, trials)
        if (name, seed) in made:
            _check_equal(made[name, seed], about, path)
            continue
        graph = random_trunk() if name == NOT_TRAINED else _trained(out / "runs", name, wanted)
        row = {"without": name, "seed": seed, **about, "aupro_fpr01": _read(graph, trials, open_trial)}
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
        say(f"{name}, seed {seed}: {row['aupro_fpr01']}")
    return rows


def measure_costs(out: Path, rounds: int = 30) -> None:
    """Add the effects' processor times to the rows, if they are not there yet; the least of some rounds."""
    path = out / ROWS
    if any("costs_ms" in row for row in rows_of(path)):
        return
    complete, each = effect_costs(rounds=rounds)
    row = {"press_ms": round(complete, 3), "costs_ms": {name: round(ms, 3) for name, ms in each.items()}}
    out.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def _planned(
    recipe: TrainConfig, seeds: int, variants: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, int, TrainConfig]]:
    """Name, seed and recipe of each trunk: those with every effect, then the others, seed by seed."""
    yield NOT_TRAINED, 0, recipe
    for seed in range(seeds + _MORE_SEEDS):
        yield ALL, seed, recipe.model_copy(update={"seed": seed})
    for seed in range(seeds):
        for name, effects in variants.items():
            if name != ALL:
                yield name, seed, recipe.model_copy(update={"seed": seed, "effects": effects})


def _about(recipe: TrainConfig, trials: Sequence[TrialReading]) -> dict[str, Any]:
    return {
        "recipe": {k: v for k, v in json.loads(recipe.to_json()).items() if k not in ("seed", "effects")},
        "real": [trial.name for trial in trials if trial.is_real],
    }


def _check_equal(row: Mapping[str, Any], about: Mapping[str, Any], path: Path) -> None:
    for key, wanted in about.items():
        if row[key] != wanted:
            raise ConfigError(
                f"'{path}' has rows of another {key} ({row[key]}, not {wanted}); choose another folder"
            )


def _trained(runs: Path, name: str, recipe: TrainConfig) -> bytes:
    """The trunk of one variant up to layer1; an interrupted training is continued."""
    from calibration.training.checkpoint import latest, load
    from calibration.training.package import trunk_state
    from calibration.training.train import TrainingRun, train

    folder = runs / f"{name.replace(' ', '_')}_{recipe.seed}"
    resume = folder if latest(folder) else None
    train(recipe, TrainingRun(folder, resume=resume, save_every=100, threads=1, device="cpu"))
    return build_trunk(trunk_state(load(folder).weights), "resnet18", (_TAP,))


def _read(
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


def _chosen(only: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Every variant, or those of these names and every effect. Errors: ConfigError for an unknown name."""
    for name in only:
        if name not in VARIANTS:
            raise ConfigError(f"no variant is named '{name}'; {suggestion(name, VARIANTS)}")
    return {name: VARIANTS[name] for name in VARIANTS if not only or name in (ALL, *only)}


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    parser = argparse.ArgumentParser(
        prog="calibration.benchmark.effect_ablation", description="Train trunks without each effect in turn."
    )
    parser.add_argument("out", type=Path, help="output folder; an interrupted run in it is continued")
    parser.add_argument("--tactile", type=Path, required=True, help="folder of real tactile frames")
    parser.add_argument(
        "--seeds", type=int, default=1, help="trunks of each kind; of those with every effect 3 more"
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="EFFECT",
        help="leave out only this one, for further seeds where the first leave a doubt; may be given several times",
    )
    parser.add_argument("--steps", type=int, default=120, help="optimiser steps of each trunk")
    parser.add_argument("--pairs", type=int, default=8, help="pairs of frames per step")
    parser.add_argument("--side", type=int, default=96, help="pixels per side of a frame")
    given = parser.parse_args(words)
    try:
        recipe = TrainConfig.shipped(steps=given.steps, pairs=given.pairs, side=given.side, stages=1)
        if not given.tactile.is_dir():
            raise ConfigError(
                f"'{given.tactile}' is no folder of real tactile frames; name it with --tactile"
            )
        variants = _chosen(given.only)
        measure_costs(given.out)
        ablate(given.out, recipe, given.seeds, readings(given.tactile), variants)
    except (GelgateError, OSError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
