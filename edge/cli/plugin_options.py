"""`--option name=value` on the command line, as a plugin's options."""

from collections.abc import Sequence
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from edge.cli.named_values import named_values
from edge.core.errors import ConfigError
from edge.validation_messages import numbered, sentences

__all__ = ["plugin_options"]

OptionsT = TypeVar("OptionsT", bound=BaseModel)


def plugin_options(kind: str, name: str, model: type[OptionsT], given: Sequence[str]) -> OptionsT:
    """The plugin's `Options` from texts such as `pace=0`.

    Errors: ConfigError with every fault.
    """
    try:
        return model.model_validate(named_values("--option", given))
    except ValidationError as error:
        faults = numbered(f"--option for the {kind} plugin '{name}'", sentences(model, error))
        raise ConfigError(f"{faults}\nit takes: {', '.join(model.model_fields)}") from error
