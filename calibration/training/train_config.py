"""Every setting of a training run. Two runs with equal settings give equal weights on one machine.

The values of the run that ships are in `shipped.toml`.
"""

import hashlib
import json
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edge.core.errors import ConfigError
from edge.validation_messages import numbered, sentences

__all__ = ["STAGES", "TrainConfig"]

STAGES = ("layer1", "layer2", "layer3")
# What every run does; earlier versions had settings for it, so that recipes of their runs name it.
_ALWAYS = {
    "distance": "euclidean",
    "effects": [
        *("pose_jitter", "partial_contact", "deformation", "residual_imprint", "dust", "wear", "shadows"),
        *("specular", "grain", "markers", "lens_blur", "led_drift", "noise", "jpeg"),
    ],
    "stages": 3,
}


class TrainConfig(BaseModel):
    """Settings of one training run."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(ge=0, description="of the weights and of every batch")
    steps: int = Field(ge=1, description="optimiser steps")
    pairs: int = Field(ge=1, description="pairs of frames per step")
    side: int = Field(ge=64, multiple_of=32, description="pixels per side of a frame")
    geometry_weight: float = Field(ge=0, description="of the loss of slopes and depth; 0 leaves it out")
    pair_weight: float = Field(ge=0, description="of the loss that pulls and pushes pairs; 0 leaves it out")
    rank_weight: float = Field(ge=0, description="of the loss that ranks changes above 1 %; 0 leaves it out")
    max_rate: float = Field(gt=0, description="peak of the one-cycle learning rate")
    warm_up: float = Field(ge=0, lt=1, description="share of the steps until that peak")
    weight_decay: float = Field(ge=0, description="of AdamW, on weights but not on offsets")
    margin: float = Field(gt=0, description="the distance that a changed cell must reach")
    changed_mm: float = Field(description="an imprint that differs by more is a change")
    unchanged_mm: float = Field(
        ge=0, description="one that differs by less is unchanged; between the two nothing is judged"
    )
    window_mm: float = Field(
        ge=0, description="half width of the window where a cell's partner is looked for; 0: its own place"
    )
    finest_weight: float = Field(gt=0, description="of layer1; each other stage has 1")
    high_resolution: float = Field(
        ge=0, le=1, description="share of batches at the spacing of 1280x720 pictures"
    )
    precision: Literal["float32", "bfloat16"] = Field(description="of the forward pass")
    start: str = Field(description="SHA-256 of the weights that the run starts from; empty: random ones")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.geometry_weight + self.pair_weight + self.rank_weight == 0:
            raise ValueError("the three loss weights are all 0, so nothing would be learnt; set one above 0")
        if self.unchanged_mm >= self.changed_mm:
            raise ValueError(f"unchanged_mm {self.unchanged_mm} is not below changed_mm {self.changed_mm}")
        return self

    @classmethod
    def of(cls, settings: Mapping[str, Any], what: str = "the recipe") -> "TrainConfig":
        """A configuration in which every setting is given. Errors: ConfigError with every fault of `what`."""
        try:
            return cls.model_validate(settings)
        except ValidationError as error:
            raise ConfigError(numbered(what, sentences(cls, error))) from None

    @classmethod
    def shipped(cls, **changes: Any) -> "TrainConfig":
        """The settings of the run that ships, with changes. Errors: ConfigError with every fault."""
        text = files("calibration.training").joinpath("shipped.toml").read_text(encoding="utf-8")
        return cls.of(tomllib.loads(text) | changes)

    @classmethod
    def read(cls, path: Path) -> dict[str, Any]:
        """The settings that a TOML file changes. Errors: ConfigError when it cannot be read."""
        try:
            return tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ConfigError(f"the recipe {path} cannot be read: {error}") from error

    @property
    def fingerprint(self) -> str:
        """Equal for equal recipes: 12 hex digits."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:12]

    def to_json(self) -> str:
        return json.dumps(self.model_dump(), sort_keys=True, indent=2)

    @classmethod
    def from_json(cls, text: str) -> "TrainConfig":
        """Read a recipe. Errors: ConfigError for a setting that this program does not know."""
        settings = json.loads(text)
        kept = {name: value for name, value in settings.items() if _ALWAYS.get(name, ...) != value}
        return cls.of(kept)

    def differences(self, other: "TrainConfig") -> list[str]:
        """`name: ours, not theirs` for every setting that differs."""
        mine, theirs = self.model_dump(), other.model_dump()
        return [f"{name}: {mine[name]}, not {theirs[name]}" for name in mine if mine[name] != theirs[name]]
