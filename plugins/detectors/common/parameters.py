"""The common base of all methods' parameters: plain values, validated when they are made."""

from collections.abc import Mapping
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edge.core.detector import Mode
from edge.core.errors import FitError
from edge.validation_messages import sentences

__all__ = ["Parameters", "Unit", "choose", "repaired"]

Unit = Literal["mm", "px"]


class Parameters(BaseModel):
    """The parameters of one method: fields with a description each, which docs/parameters.md prints."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    mode: Mode = Field(default="corrected", description="the settings to start from")


P = TypeVar("P", bound=Parameters)


def choose(detector: str, defaults: P, published: P, overrides: Mapping[str, Any]) -> P:
    """The defaults with named fields replaced; a list is taken as a tuple.

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


def repaired(parameters: Parameters, published: Parameters, switches: tuple[str, ...]) -> list[str]:
    """The named switches whose value is not the published one, as `name=value`: the repairs of a manifest."""
    values = {
        **{name: field.default for name, field in type(published).model_fields.items()},
        **dict(parameters),
    }
    return [f"{name}={values[name]}" for name in switches if values[name] != getattr(published, name)]
