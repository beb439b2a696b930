"""Every setting of a training run. Two runs with equal recipes and seeds learn equal weights on one machine."""

import dataclasses
import hashlib
import json
import typing
from dataclasses import dataclass
from typing import Literal

from edge.core.errors import ConfigError

__all__ = ["STAGES", "Distance", "Recipe"]

STAGES = ("layer1", "layer2", "layer3")
# What runs did before these settings existed, which their files do not say.
_BEFORE = {"window_mm": 0.0, "finest_weight": 1.0, "distance": "cosine", "start": ""}
Distance = Literal["cosine", "euclidean"]


@dataclass(frozen=True)
class Recipe:
    """Settings of one training run.

    seed: of weights and of every batch. steps, pairs, side: optimiser steps, pairs per step, pixels per side.
    The weights of the three losses: 0 leaves one out. max_rate: the peak of the one-cycle learning rate.
    margin: the distance that a changed cell must reach. changed_mm, unchanged_mm: an imprint that differs by
    more is a change, one that differs by less is none, and what lies between is not judged. window_mm: half width of
    the window where a cell's partner is looked for, 0 for its own place. finest_weight: of layer1 beside 1 of each
    other stage. distance: `euclidean` between features as they are, `cosine` between their directions alone.
    high_resolution: share of batches at the spacing of 1280x720 pictures. precision: of the forward pass; `int8` rounds
    as the int8 variant does, for a run that begins with other weights. start: SHA-256 of the weights of another run
    that this one begins with, empty to begin at random.
    """

    seed: int = 0
    steps: int = 1800
    pairs: int = 64
    side: int = 224
    geometry_weight: float = 1.0
    pair_weight: float = 1.0
    rank_weight: float = 0.5
    max_rate: float = 2e-3
    warm_up: float = 0.15
    weight_decay: float = 0.02
    margin: float = 1.0
    changed_mm: float = 0.02
    unchanged_mm: float = 0.004
    window_mm: float = 0.5
    finest_weight: float = 2.0
    distance: Distance = "euclidean"
    high_resolution: float = 0.25
    precision: Literal["float32", "bfloat16", "int8"] = "bfloat16"
    start: str = ""

    def __post_init__(self) -> None:
        if min(self.steps, self.pairs) < 1 or self.seed < 0:
            raise ConfigError(f"steps and pairs are at least 1 and the seed 0, found {self}")
        if self.side < 64 or self.side % 32:
            raise ConfigError(f"side is a multiple of 32 from 64 on, found {self.side}")
        if min(self.geometry_weight, self.pair_weight, self.rank_weight) < 0 or not self.is_learning:
            raise ConfigError("loss weights are 0 or more and not all 0")
        if not 0 <= self.unchanged_mm < self.changed_mm:
            raise ConfigError(
                f"unchanged_mm lies below changed_mm, found {self.unchanged_mm} and {self.changed_mm}"
            )
        if not (self.window_mm >= 0 and self.finest_weight > 0):
            raise ConfigError(
                f"window_mm is at least 0 and finest_weight positive, found {self.window_mm} and {self.finest_weight}"
            )
        if self.distance not in ("cosine", "euclidean"):
            raise ConfigError(f"distance is cosine or euclidean, found '{self.distance}'")
        if self.precision not in ("float32", "bfloat16", "int8"):
            raise ConfigError(f"precision is float32, bfloat16 or int8, found '{self.precision}'")
        if self.precision == "int8" and not self.start:
            raise ConfigError(
                "precision int8 keeps the batch norms' statistics and needs a run to begin with"
            )

    @property
    def is_learning(self) -> bool:
        return self.geometry_weight + self.pair_weight + self.rank_weight > 0

    @property
    def fingerprint(self) -> str:
        """Equal for equal recipes: 12 hex digits."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:12]

    def to_json(self) -> str:
        return json.dumps(dataclasses.asdict(self), sort_keys=True, indent=2)

    @classmethod
    def from_json(cls, text: str) -> "Recipe":
        """Errors: ConfigError for a setting that this program does not know."""
        given = json.loads(text)
        unknown = sorted(set(given) - {f.name for f in dataclasses.fields(cls)})
        if unknown:
            raise ConfigError(
                f"a recipe with the unknown settings {', '.join(unknown)}: it is from another version"
            )
        return cls(**(_BEFORE | given))

    @classmethod
    def kinds(cls) -> dict[str, type]:
        """Setting to the type that a word on the command line becomes."""
        hints = typing.get_type_hints(cls)
        return {
            f.name: hints[f.name] if hints[f.name] in (int, float) else str for f in dataclasses.fields(cls)
        }

    def differences(self, other: "Recipe") -> list[str]:
        """`name: ours, not theirs` for every setting that differs."""
        mine, theirs = dataclasses.asdict(self), dataclasses.asdict(other)
        return [f"{name}: {mine[name]}, not {theirs[name]}" for name in mine if mine[name] != theirs[name]]
