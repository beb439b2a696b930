"""Names to plugins, through entry points; built-ins and visitors come through the same door.

A plugin is loaded only when it is named, so an unused one costs nothing and cannot run.
"""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from edge.core.errors import ConfigError
from edge.core.suggest import suggestion

__all__ = ["load", "names"]


@cache
def _group(kind: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=f"gelgate.{kind}")}


def names(kind: str) -> list[str]:
    """The names that can be chosen for a kind: devices, sinks, triggers, actuators, detectors, backbones, commands."""
    return sorted(_group(kind))


def load(kind: str, name: str) -> Any:
    """The object behind a plugin's name. Errors: ConfigError with the nearest known name, or why it cannot load."""
    point = _group(kind).get(name)
    if point is None:
        raise ConfigError(f"no {kind} plugin is named '{name}'; {suggestion(name, names(kind))}")
    try:
        return point.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"the {kind} plugin '{name}' ({point.value}) cannot be loaded: {error}; "
            "install the extra it belongs to, such as pip install 'gelgate[oak]'"
        ) from error
