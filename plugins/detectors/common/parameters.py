"""The common base of all methods' parameters: plain values, validated when they are made."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edge.core.detector import Grid, Mode
from edge.core.errors import FitError
from edge.validation_messages import sentences
from plugins.detectors.common.descriptor import Kind
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, UPSAMPLING, Smoothing

__all__ = [
    "Balanced", "ChannelProjection", "Channels", "DescriptorKind", "Dims", "EmbeddingParameters", "GridTap", "MarginMm",
    "Parameters", "Rng",
    "Sampled", "Sigma", "SigmaUnit", "Squared", "Taps", "choose", "list_repairs",
]  # fmt: skip

Rng = np.random.Generator

Projection = Literal["all", "random", "semi_orthogonal"]
"""all: every channel. random: the given number, drawn once (PaDiM). semi_orthogonal: a random orthonormal frame of the
given number of directions over all channels (Kim et al., arXiv 2105.14737)."""

# What several methods have a parameter for.
Taps = Annotated[tuple[str, ...], Field(description="the taps that make a descriptor, in this order")]
GridTap = Annotated[str, Field(description="the tap on whose grid descriptors live")]
ChannelProjection = Annotated[
    Projection,
    Field(
        description="how channels become fewer: all stay, a random choice of some, or a random orthonormal frame"
    ),
]
Channels = Annotated[int | None, Field(ge=1, description="channels that remain; null: all")]
DescriptorKind = Annotated[
    Kind,
    Field(
        description="each cell's channels, the published 3x3 windows averaged to bins, or the windows' means"
    ),
]
Dims = Annotated[
    int | None,
    Field(ge=1, description="leading directions kept, in addition to the length of the rest; null: all"),
]
Balanced = Annotated[
    bool, Field(description="divide each tap by its nominal deviation, so that no tap dominates by its scale")
]
Sampled = Annotated[
    bool, Field(description="draw a cell at its top left pixel, where its convolution looks, not as a square")
]
MarginMm = Annotated[float, Field(ge=0, description="places this near to a touched pixel count as touched")]
Sigma = Annotated[float, Field(ge=0, description="the blur, in `sigma_unit`")]
SigmaUnit = Annotated[
    Literal["mm", "px"], Field(description="whether the blur is the same on the part or in the picture")
]
Squared = Annotated[bool, Field(description="squared distances, as published")]


class Parameters(BaseModel):
    """The parameters of one method: fields with a description each, which docs/parameters.md prints."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    mode: Mode = Field(default="corrected", description="the settings to start from")


class EmbeddingParameters(Parameters):
    """What a descriptor of several taps is made of: see `plugins.detectors.common.embedding`."""

    taps: Taps
    grid_tap: GridTap
    projection: ChannelProjection = "semi_orthogonal"
    channels: Channels
    is_balanced: Balanced = True
    is_sampled: Sampled = True
    sigma: Sigma = PAPER_SIGMA_MM
    sigma_unit: SigmaUnit = "mm"

    @property
    def listed_channels(self) -> tuple[int, ...]:
        """Channels, counted through all taps, instead of a random choice; `channels` then has no effect."""
        return ()

    @model_validator(mode="after")
    def _makes_an_embedding(self) -> Self:
        taps, listed = self.taps, self.listed_channels
        if not taps or len(set(taps)) != len(taps):
            raise ValueError(f"taps must be distinct and at least one, found {taps}")
        if self.grid_tap not in taps:
            raise ValueError(f"grid_tap '{self.grid_tap}' is not among the taps {', '.join(taps)}")
        if listed and self.projection != "random":
            raise ValueError(
                f"channel_list is a choice of channels: projection=random, found '{self.projection}'"
            )
        if len(set(listed)) != len(listed) or min(listed, default=0) < 0:
            raise ValueError(
                "channel_list holds different channel numbers, 0 or more, counted through all taps"
            )
        if self.projection != "all" and not listed and self.channels is None:
            raise ValueError(f"projection '{self.projection}' needs channels >= 1, found {self.channels}")
        return self

    def smoothing(self, grid: Grid, cells: tuple[int, int]) -> Smoothing:
        return Smoothing.of(grid, cells, self.sigma, UPSAMPLING[self.is_sampled], self.sigma_unit)


P = TypeVar("P", bound=Parameters)


def choose(detector: str, defaults: P, published: P, overrides: Mapping[str, Any]) -> P:
    """Replace named fields of the defaults; a list is taken as a tuple.

    published: the published variant, whose class also has the switches of published defects. They are accepted in both
    modes. Errors: FitError for an unknown name, with the nearest known one, or a value that a field refuses.
    """
    full = type(published)
    is_plain = overrides.keys() <= type(defaults).model_fields.keys()
    kind = type(defaults) if is_plain else full
    try:
        return kind.model_validate({**dict(defaults), **overrides})
    except ValidationError as error:
        raise FitError(f"{detector}: {'; '.join(sentences(full, error))}") from None


def list_repairs(parameters: Parameters, published: Parameters, switches: tuple[str, ...]) -> list[str]:
    """List the switches whose value is not the published one, as `name=value`: the repairs of a manifest."""
    values = {
        **{name: field.default for name, field in type(published).model_fields.items()},
        **dict(parameters),
    }
    return [f"{name}={values[name]}" for name in switches if values[name] != getattr(published, name)]
