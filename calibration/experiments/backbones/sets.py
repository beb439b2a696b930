"""The evaluation sets: presses of parts, damage and sensors that training never draws.

Every set is a list of trials that any process can make. `sets.toml` says what each set shows, and what it cannot show.
"""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files

from calibration.experiments.backbones.presses import PARTS, Trial, part_trial, random_part_trial

__all__ = ["SETS", "EvaluationSet", "evaluation_sets"]


@dataclass(frozen=True)
class EvaluationSet:
    """Trials whose measures are averaged."""

    title: str
    text: str
    """What they show, and what they cannot show."""
    trials: tuple[Callable[[], Trial], ...]
    is_brief: bool = False
    """Only the first backbone and random weights are compared on it."""


_DESCRIPTIONS = tomllib.loads(
    files("calibration.experiments.backbones").joinpath("sets.toml").read_text(encoding="utf-8")
)

SETS = tuple(_DESCRIPTIONS)
"""The names of the sets, in the order of the tables."""

# Three parts are enough for the effects of gel and press.
_FEW = tuple(part for part in PARTS if part in ("PZ1", "PZ4", "PZ5"))


def evaluation_sets() -> dict[str, EvaluationSet]:
    """Return every set by its name in `SETS`."""
    trials: dict[str, Sequence[Callable[[], Trial]]] = {
        "random-parts": [partial(random_part_trial, number) for number in range(6)],
        "parts": [partial(part_trial, part) for part in PARTS],
        "sensor": [partial(part_trial, part, "unseen sensor") for part in PARTS],
        "worn-gel": [partial(part_trial, part, "worn gel") for part in _FEW],
        "marker-gel": [partial(part_trial, part, "marker gel") for part in _FEW],
        "residual-imprint": [partial(part_trial, part, "residual imprint") for part in _FEW],
        "sliding-press": [partial(part_trial, part, "sliding press") for part in _FEW],
    }
    return {name: EvaluationSet(**about, trials=tuple(trials[name])) for name, about in _DESCRIPTIONS.items()}
