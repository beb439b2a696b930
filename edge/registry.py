"""Names to plugins, through entry points, the same for built-in plugins and those of other packages.

A plugin is loaded only when it is named, so an unused one costs nothing and cannot run. An object without the protocol
of its group (`edge.core.plugins`) is refused here, so that no other code has to check it.
"""

from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from edge.core.errors import ConfigError
from edge.core.suggest import suggestion

if TYPE_CHECKING:
    import typer
    from pydantic import BaseModel

    from edge.core.detector import Detector
    from edge.core.plugins import (
        ActuatorPlugin,
        Backbone,
        DevicePlugin,
        HandshakePlugin,
        SinkPlugin,
        TriggerPlugin,
    )

__all__ = [
    "Group",
    "PluginGroup",
    "Verb",
    "actuator",
    "backbone",
    "command",
    "detector",
    "device",
    "feature",
    "foreign",
    "handshake",
    "hidden_package",
    "importer",
    "names",
    "options",
    "overview",
    "sink",
    "trigger",
]

Group: TypeAlias = Literal[
    "devices",
    "overviews",
    "sinks",
    "triggers",
    "actuators",
    "handshakes",
    "detectors",
    "backbones",
    "importers",
    "features",
    "commands",
]
"""The last part of an entry point group's name, `gelgate.<group>`."""

PluginGroup: TypeAlias = Literal["devices", "overviews", "sinks", "triggers", "actuators", "handshakes"]
"""The groups with a table in the configuration."""

Verb: TypeAlias = "typer.Typer | Callable[..., None]"


def names(group: Group) -> list[str]:
    """The known names of a group."""
    return sorted(_points(group))


def foreign(group: Group) -> Mapping[str, str]:
    """Return the names of a group that other packages than gelgate bring, each with its package."""
    packages = {name: _package(points[0]) for name, points in sorted(_points(group).items())}
    return {name: package for name, package in packages.items() if package != "gelgate"}


def command(name: str) -> Verb:
    """The verb of that name: a function, or a group of them. Errors: as `device`."""
    verb = _load("commands", name)
    if callable(verb):
        return verb
    raise ConfigError(f"the entry point '{name}' of gelgate.commands is not a function; correct its package")


_installed = cache(entry_points)
"""Every entry point that there is: each installed package is read for them, whatever the group."""


@cache
def _points(group: Group) -> Mapping[str, list[EntryPoint]]:
    points: dict[str, list[EntryPoint]] = {}
    for point in _installed().select(group=f"gelgate.{group}"):
        known = points.setdefault(point.name, [])
        if point.value not in [one.value for one in known]:
            known.append(point)
    return points


def _plugin(group: Group, name: str) -> Any:
    plugin, protocol = _load(group, name), _protocol(group)
    if isinstance(plugin, protocol):
        return plugin
    lacking = sorted(var for var in vars(protocol) if not var.startswith("_") and not hasattr(plugin, var))
    raise ConfigError(
        f"the {group} plugin '{name}' is a {type(plugin).__name__} without {', '.join(lacking)}; "
        f"an entry point of gelgate.{group} names an object that has them (docs/plugins.md)"
    )


def _protocol(group: Group) -> type:
    """What the plugins of a group have. It is imported at use: a start without plugins must be quick."""
    from edge.core import plugins
    from edge.core.detector import Detector

    return {
        "devices": plugins.DevicePlugin,
        "overviews": plugins.DevicePlugin,
        "sinks": plugins.SinkPlugin,
        "triggers": plugins.TriggerPlugin,
        "actuators": plugins.ActuatorPlugin,
        "handshakes": plugins.HandshakePlugin,
        "detectors": Detector,
        "backbones": plugins.Backbone,
    }[group]


def _load(group: Group, name: str) -> object:
    points = _points(group).get(name, [])
    if not points:
        raise ConfigError(f"no {group} plugin is named '{name}'; {suggestion(name, names(group))}")
    if len(points) > 1:
        rivals = " and ".join(f"{point.value} ({_package(point)})" for point in points)
        raise ConfigError(
            f"the {group} plugin '{name}' is claimed by {rivals}; uninstall one of the packages"
        )
    try:
        loaded: object = points[0].load()
    except (Exception, SystemExit) as error:  # whatever the code of another package does while it is imported
        package = _package(points[0])
        remedy = hidden_package(points[0].module) if package == "gelgate" else None
        raise ConfigError(
            f"the {group} plugin '{name}' of {package} ({points[0].value}) cannot be loaded: "
            f"{error if isinstance(error, ImportError | AttributeError) else repr(error)}; "
            + (
                remedy
                or f"pip install the packages it needs, such as the extras of {package}, or uninstall it"
            )
        ) from error
    return loaded


def hidden_package(module: str) -> str | None:
    """Which folder hides the package of gelgate that this module is in, as a sentence; None if none does."""
    package, ours = module.partition(".")[0], Path(__file__).resolve().parents[1]
    spec = find_spec(package) if package and (ours / package).is_dir() else None
    places = list((spec and spec.submodule_search_locations) or [spec.origin if spec and spec.origin else ""])
    path = Path(places[0]).resolve()
    if spec is None or path.parent == ours:
        return None
    return f"{path} hides gelgate's own package '{package}'; rename it, or take {path.parent} off PYTHONPATH"


@cache
def _package(point: EntryPoint) -> str:
    """Name the package of an entry point. It is kept: its metadata is a file, and known alarms ask with each frame."""
    return point.dist.name if point.dist is not None else "an unknown package"


device: "Callable[[str], DevicePlugin[BaseModel]]" = partial(_plugin, "devices")
"""The device plugin of a name.

Errors, here and below: ConfigError for an unknown name, with the nearest known one; for a name of two packages; for a
plugin that cannot be loaded; and for an object without the protocol of its group.
"""
overview: "Callable[[str], DevicePlugin[BaseModel]]" = partial(_plugin, "overviews")
sink: "Callable[[str], SinkPlugin[BaseModel]]" = partial(_plugin, "sinks")
trigger: "Callable[[str], TriggerPlugin[BaseModel]]" = partial(_plugin, "triggers")
actuator: "Callable[[str], ActuatorPlugin[BaseModel]]" = partial(_plugin, "actuators")
handshake: "Callable[[str], HandshakePlugin[BaseModel]]" = partial(_plugin, "handshakes")
detector: "Callable[[str], Detector]" = partial(_plugin, "detectors")
backbone: "Callable[[str], Backbone]" = partial(_plugin, "backbones")
importer: Callable[[str], object] = partial(_load, "importers")
"""The importer of a name; `export.importers.contract` checks its protocol."""
feature: Callable[[str], object] = partial(_load, "features")
"""The feature of a name; `edge.gateway.features` checks its class."""


def options(group: PluginGroup, name: str) -> "type[BaseModel]":
    """The model of a plugin's TOML table. Errors: as `device`."""
    model: type[BaseModel] = _plugin(group, name).Options
    return model
