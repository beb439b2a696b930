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
    arguments,
    chosen,
    complete,
    exit_code,
    opened,
    read,
    readings,
    rows_of,
    trained,
)
from calibration.benchmark.trial import Trial
from calibration.simulator.effects import EFFECTS as SIMULATED
from calibration.training.train_config import EFFECTS, TrainConfig

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


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    given = arguments(
        "calibration.benchmark.effect_ablation",
        "Train trunks without each effect in turn.",
        "trunks of each kind; of those with every effect 3 more",
        (
            "EFFECT",
            "leave out only this one, for further seeds where the first leave a doubt; may be given several times",
        ),
    ).parse_args(words)
    return exit_code(partial(_run, given))


def _run(given: argparse.Namespace) -> None:
    """Errors: ConfigError for a wrong recipe, folder or name."""
    recipe = TrainConfig.shipped(steps=given.steps, pairs=given.pairs, side=given.side, stages=1)
    trials = readings(given.tactile)
    variants = {name: VARIANTS[name] for name in chosen(given.only, VARIANTS, ALL, "variant")}
    measure_costs(given.out)
    ablate(given.out, recipe, given.seeds, trials, variants)


if __name__ == "__main__":
    sys.exit(main())
