"""What each idea for real touch is worth: short trunks, each learnt with one idea more than the others.

    python -m calibration.benchmark.idea_ablation OUT --tactile REAL_TACTILE --seeds 2

trains layer1 of the tactile trunk for some steps on presses without `pose_jitter`, with one idea each, everything else
equal, for every seed. PaDiM and PatchCore read each trunk as `calibration.benchmark.effect_ablation` does, and then its
first block joined to EfficientNet-Lite0, as in `tactile_lite0`. `OUT/ideas.jsonl` has a line for each trunk; the same
command continues an interrupted run. `calibration.benchmark.idea_table` prints the table of docs/backbone.md.

An idea that learns from real frames reads them from REAL_TACTILE, and is skipped with a sentence where they are absent.
They are of sensors that are neither in the development set of real touch nor in its set of judgement.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.evaluation import random_trunk
from calibration.benchmark.idea_inputs import of_differences
from calibration.benchmark.ideas import (
    BASE,
    DIFFERENCE,
    IDEAS,
    NOT_TRAINED,
    PHOTOGRAPH,
    PHOTOGRAPH_OF_IT,
    RATIO,
)
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
    trained,
)
from calibration.benchmark.trial import Trial
from calibration.training.train_config import EFFECTS, TrainConfig
from edge.core.errors import DatasetError
from edge.model.onnx_prune import cut_trunk
from edge.model.session import open_session

__all__ = ["ROWS", "Comparison", "ablate", "joined", "simulated_presses"]

ROWS = "ideas.jsonl"
_MORE_SEEDS = 2
_TACTILE_CHANNELS = 64


@cache
def simulated_presses() -> NDArray[np.uint8]:
    """Frames (32, 224, 224, 3) that neither training nor a trial has."""
    from calibration.training.package import calibration_frames

    return np.concatenate(list(calibration_frames("scale", 2)))


@dataclass(frozen=True)
class Comparison:
    """What every trunk is learnt and read with. data: the folder of real tactile frames.

    frames: give the frames on which the parts of a joined trunk are weighed, uint8 (n, h, w, 3).
    """

    data: Path
    trials: Sequence[TrialReading]
    frames: Callable[[], NDArray[np.uint8]] = simulated_presses


def ablate(
    out: Path,
    recipe: TrainConfig,
    seeds: int,
    of: Comparison,
    ideas: Sequence[str] = tuple(IDEAS),
    say: Callable[[str], None] = print,
) -> list[dict[str, Any]]:
    """Train and read what is not yet in `OUT/ideas.jsonl`; every row.

    recipe: of every trunk, but for the seed. seeds: trunks of each idea; of the base two more. Errors: ConfigError for
    a folder with rows of another recipe or other trials.
    """
    open_trial = opened()
    planned = [
        ShortTrunk(
            name,
            seed,
            about(recipe, of.trials),
            partial(_measured, out / "runs", name, recipe.model_copy(update={"seed": seed}), of, open_trial),
        )
        for name, seed in _planned(seeds, _possible(ideas, recipe, of.data, say))
    ]
    return complete(out / ROWS, "idea", planned, say)


def _possible(
    ideas: Sequence[str], recipe: TrainConfig, data: Path, say: Callable[[str], None]
) -> Iterator[str]:
    """The ideas whose frames are there; of another it is said that it is skipped."""
    from calibration.benchmark.idea_lessons import LESSONS

    for name in ideas:
        try:
            LESSONS[name](recipe, data)
        except DatasetError as error:
            say(f"SKIPPED, NOT MEASURED: {name}: {error}")
        else:
            yield name


def _planned(seeds: int, ideas: Iterator[str]) -> Iterator[tuple[str, int]]:
    """Name and seed of each trunk: first what the ideas are compared with, then they, seed by seed."""
    names = list(ideas)
    yield from ((name, 0) for name in (NOT_TRAINED, PHOTOGRAPH))
    if DIFFERENCE in names:
        yield PHOTOGRAPH_OF_IT, 0
    yield from ((BASE, seed) for seed in range(seeds + _MORE_SEEDS))
    yield from ((name, seed) for seed in range(seeds) for name in names if name != BASE)


def _measured(
    runs: Path,
    name: str,
    recipe: TrainConfig,
    of: Comparison,
    open_trial: Callable[[TrialReading], Trial],
) -> dict[str, Any]:
    """AU-PRO of the trunk alone and joined; of the network of photographs in place of both."""
    if name in (DIFFERENCE, PHOTOGRAPH_OF_IT):
        seen, open_trial = open_trial, cache(lambda reading: of_differences(seen(reading)))
    if name in (PHOTOGRAPH, PHOTOGRAPH_OF_IT):
        from plugins.backbones.efficientnet_lite0 import efficientnet_lite0

        found = read(efficientnet_lite0.trunk(), of.trials, open_trial)
        return {"aupro_fpr01": found, "joined_aupro_fpr01": found}
    graph = random_trunk() if name == NOT_TRAINED else _taught(runs, name, recipe, of.data)
    return {
        "aupro_fpr01": read(graph, of.trials, open_trial),
        "joined_aupro_fpr01": read(joined(graph, of.frames()), of.trials, open_trial),
    }


def _taught(runs: Path, name: str, recipe: TrainConfig, data: Path) -> bytes:
    from calibration.benchmark.idea_lessons import LESSONS

    return trained(runs, name, *LESSONS[name](recipe, data))


def joined(tactile: bytes, frames: NDArray[np.uint8]) -> bytes:
    """The first block of a trunk, and EfficientNet-Lite0, whose channels vary twice as much on these frames."""
    from calibration.training.joined_trunk import build_tactile_lite0
    from plugins.backbones.efficientnet_lite0 import installed_weights

    lite0 = installed_weights()
    plain = cut_trunk(build_tactile_lite0(tactile, lite0, scale=1.0), ("layer1",))
    (maps,) = open_session(plain, 1, "trunk").run(["layer1"], {"frames": frames})
    varied = maps.var(axis=(0, 2, 3))
    felt, seen = (float(np.sqrt(part.sum())) for part in np.split(varied, [_TACTILE_CHANNELS]))
    return build_tactile_lite0(tactile, lite0, scale=seen / (RATIO * felt))


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    given = arguments(
        "calibration.benchmark.idea_ablation",
        "Train trunks with each idea in turn.",
        "trunks of each idea; of the base 2 more",
        ("IDEA", "this idea and the base; may be given several times"),
    ).parse_args(words)
    return exit_code(partial(_run, given))


def _run(given: argparse.Namespace) -> None:
    """Errors: ConfigError for a wrong recipe, folder or name."""
    recipe = TrainConfig.shipped(
        steps=given.steps,
        pairs=given.pairs,
        side=given.side,
        stages=1,
        effects=tuple(name for name in EFFECTS if name != "pose_jitter"),
    )
    of = Comparison(given.tactile, readings(given.tactile))
    ablate(given.out, recipe, given.seeds, of, chosen(given.only, IDEAS, BASE, "idea"))


if __name__ == "__main__":
    sys.exit(main())
