"""Names to plugins: one shape of entry point, and a sentence for any other."""

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from edge import registry
from edge.core.detector import Detector
from edge.core.errors import ConfigError
from edge.core.plugins import ActuatorPlugin, Backbone, DevicePlugin, SinkPlugin, TriggerPlugin

ROOT = Path(__file__).resolve().parents[2]
PROTOCOLS = {
    "devices": (registry.device, DevicePlugin),
    "overviews": (registry.overview, DevicePlugin),
    "sinks": (registry.sink, SinkPlugin),
    "triggers": (registry.trigger, TriggerPlugin),
    "actuators": (registry.actuator, ActuatorPlugin),
    "detectors": (registry.detector, Detector),
    "backbones": (registry.backbone, Backbone),
}


def install(monkeypatch: pytest.MonkeyPatch, group: str, name: str, *values: str) -> None:
    """Entry points of that name, as packages by others bring them."""
    points = [EntryPoint(name, value, f"gelgate.{group}") for value in values]
    monkeypatch.setattr(registry, "_points", lambda asked: {name: points} if asked == group else {})


@pytest.mark.parametrize("group", PROTOCOLS)
def test_every_installed_plugin_meets_its_protocol(group: str) -> None:
    """The registry gives an object of the group's type for every name."""
    get, protocol = PROTOCOLS[group]

    assert registry.names(group)
    assert all(isinstance(get(name), protocol) for name in registry.names(group))


def test_installed_packages_are_read_once() -> None:
    """Every group is in the same files: one for each package that is installed, which takes a start 10 ms a group."""
    registry._points.cache_clear()
    registry._installed.cache_clear()
    assert registry.names("devices")
    assert registry.names("sinks")
    assert registry._installed.cache_info().misses == 1


@pytest.mark.parametrize("group", [*PROTOCOLS, "commands"])
def test_every_entry_point_names_a_value_in_a_module(group: str) -> None:
    """One shape for all groups: `package.module:value`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    values = list(project["entry-points"][f"gelgate.{group}"].values())

    assert values
    assert [value for value in values if value.count(":") != 1] == []


@pytest.mark.parametrize("group", PROTOCOLS)
def test_another_shape_is_refused_with_what_it_lacks(group: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module is not a plugin."""
    install(monkeypatch, group, "odd", "types:SimpleNamespace")
    get, _ = PROTOCOLS[group]

    with pytest.raises(ConfigError, match=rf"the {group} plugin 'odd' is a type without .*docs/plugins.md"):
        get("odd")


@pytest.mark.parametrize(
    ("group", "name", "values", "words"),
    [
        ("commands", "odd", ["math:pi"], r"'odd' of gelgate.commands is not a function"),
        # None of the two is loaded.
        (
            "sinks",
            "lamp",
            ["plugins.sinks.memory:plugin", "plugins.sinks.jsonl:plugin"],
            r"'lamp' is claimed by plugins.sinks.memory:plugin .* uninstall one",
        ),
        ("detectors", "padmi", [], r"no detectors plugin is named 'padmi'; did you mean 'padim'"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused(
    monkeypatch: pytest.MonkeyPatch, group: str, name: str, values: list[str], words: str
) -> None:
    if values:
        install(monkeypatch, group, name, *values)
    get = registry.command if group == "commands" else PROTOCOLS[group][0]
    with pytest.raises(ConfigError, match=words):
        get(name)
