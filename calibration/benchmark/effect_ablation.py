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
from functools import partial
from pathlib import Path
from typing import Any

from calibration.benchmark.effect_costs import effect_costs
from calibration.benchmark.evaluation import random_trunk
from calibration.benchmark.short_trunks import (
    ShortTrunk,
    TrialReading,
    about,
    complete,
    opened,
    read,
    readings,
    rows_of,
    trained,
)
from calibration.benchmark.trial import Trial
from calibration.simulator.effects import EFFECTS as SIMULATED
from calibration.training.train_config import EFFECTS, TrainConfig
from edge.core.errors import ConfigError, GelgateError
from edge.core.suggest import suggestion

__all__ = [
    "ALL",
    "NOT_TRAINED",
    "OPTICAL",
    "ROWS",
    "VARIANTS",
    "ablate",
    "measure_costs",
]

ROWS = "effects.jsonl"
ALL, OPTICAL, NOT_TRAINED = "all effects", "no effect of light and camera", "random weights"
VARIANTS: Mapping[str, tuple[str, ...]] = {
    ALL: EFFECTS,
    **{name: tuple(other for other in EFFECTS if other != name) for name in EFFECTS},
    OPTICAL: tuple(name for name in EFFECTS if SIMULATED[name].stage not in ("light", "camera")),
}
"""Of each trunk, the effects that its presses have; under an effect's name those without it."""

_MORE_SEEDS = 3


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
    open_trial = opened()
    planned = [
        ShortTrunk(
            name,
            seed,
            about(wanted, trials, ("seed", "effects")),
            partial(_measured, out / "runs", name, wanted, trials, open_trial),
        )
        for name, seed, wanted in _planned(recipe, seeds, variants)
    ]
    return complete(out / ROWS, "without", planned, say)


def _measured(
    runs: Path,
    name: str,
    recipe: TrainConfig,
    trials: Sequence[TrialReading],
    open_trial: Callable[[TrialReading], Trial],
) -> dict[str, Any]:
    graph = random_trunk() if name == NOT_TRAINED else trained(runs, name, recipe)
    return {"aupro_fpr01": read(graph, trials, open_trial)}


def measure_costs(out: Path, rounds: int = 30) -> None:
    """Add the effects' processor times to the rows, if they are not there yet; the least of some rounds."""
    path = out / ROWS
    if any("costs_ms" in row for row in rows_of(path)):
        return
    press_ms, each = effect_costs(rounds=rounds)
    row = {"press_ms": round(press_ms, 3), "costs_ms": {name: round(ms, 3) for name, ms in each.items()}}
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
