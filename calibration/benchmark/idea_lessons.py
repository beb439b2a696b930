"""What each idea of `idea_ablation` teaches, over the recipe of them all."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from calibration.benchmark import idea_frames, idea_losses, idea_sensors
from calibration.benchmark.ideas import DIFFERENCE, RATIO
from calibration.training.prefetch import draw_step
from calibration.training.random_sensors import RandomSensors
from calibration.training.train import Lesson
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import Pairs

__all__ = ["LESSONS"]

Taught = tuple[TrainConfig, Lesson]


def _sensors(sensors: RandomSensors) -> Lesson:
    def draw(recipe: TrainConfig, step: int, device: torch.device) -> Pairs:
        return draw_step(recipe, step, device, sensors)

    return Lesson(draw)


def _base(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, Lesson()


def _units(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, _sensors(RandomSensors(appearance=idea_sensors.other_units))


def _exposure(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, _sensors(RandomSensors(gains=idea_sensors.wandering_gains))


def _dots(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, _sensors(RandomSensors(dots=idea_sensors.other_dots))


def _gels(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, _sensors(RandomSensors(appearance=idea_sensors.RealGels(idea_frames.free_gels(data))))


def _gels_and_noise(recipe: TrainConfig, data: Path) -> Taught:
    gels = idea_frames.free_gels(data)
    # The first has neither dots nor a part that is filled in.
    return recipe, _sensors(
        RandomSensors(appearance=idea_sensors.RealGels(gels), noise=idea_sensors.RealNoise(gels[:1]))
    )


def _difference(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, Lesson(idea_sensors.differences_to_free_gel)


def _real_pairs(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, Lesson(further=partial(idea_losses.RealPairs, idea_frames.presses(data), recipe))


def _distilled(recipe: TrainConfig, data: Path) -> Taught:
    return recipe, Lesson(further=idea_losses.Distilled)


def _next_to_photograph(recipe: TrainConfig, data: Path) -> Taught:
    alone = recipe.model_copy(update={"pair_weight": 0.0, "rank_weight": 0.0})
    return alone, Lesson(further=partial(idea_losses.NextToPhotograph, recipe, RATIO))


def _real_pairs_alone(recipe: TrainConfig, data: Path) -> Taught:
    lesson = Lesson(further=partial(idea_losses.RealPairs, idea_frames.presses(data), recipe))
    return recipe.model_copy(update={"pair_weight": 0.0, "rank_weight": 0.0}), lesson


def _all_real(recipe: TrainConfig, data: Path) -> Taught:
    _, sensors = _gels_and_noise(recipe, data)
    _, pairs = _real_pairs(recipe, data)
    return recipe, replace(sensors, further=pairs.further)


LESSONS: Mapping[str, Callable[[TrainConfig, Path], Taught]] = {
    "base": _base,
    "other units": _units,
    "wandering exposure": _exposure,
    "other dots": _dots,
    "real gels": _gels,
    "real gels and noise": _gels_and_noise,
    DIFFERENCE: _difference,
    "real pairs": _real_pairs,
    "real pairs alone": _real_pairs_alone,
    "real pairs, gels and noise": _all_real,
    "distilled": _distilled,
    "next to photographs": _next_to_photograph,
}
"""By the idea's name: recipe and folder of real tactile frames to what the trunk learns.

Errors: DatasetError where the idea's frames are not in the folder.
"""
