"""From a configuration's tables to the parts that they name: the store, plugins, and whoever opens the sensor."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from edge import registry
from edge.config import Config, PluginTable
from edge.core.ports import Clock, Device
from edge.store.outbox import Bounds
from edge.store.press_store import Store

__all__ = ["device_opener", "open_plugin", "open_store", "sink_names"]


def open_store(config: Config) -> Store:
    bounds = Bounds(round(config.store.outbox_mb * 1e6), config.store.outbox_days * 86400)
    return Store(config.store.path, bounds, config.gel.limit_presses, config.gel.warn_fraction)


def open_plugin(kind: str, table: PluginTable, *context: object) -> Any:
    plugin = registry.load(kind, table.plugin)
    return plugin.open(plugin.Options.model_validate(table.options), *context)


def device_opener(table: PluginTable, controls: Mapping[str, int], clock: Clock) -> Callable[[], Device]:
    """Opens the configured device, the same one each time.

    Camera controls are those of the bundle's sensor profile; the configuration may set some of them otherwise.
    """
    plugin = registry.load("devices", table.plugin)
    given = dict(table.options)
    if "controls" in plugin.Options.model_fields:
        given["controls"] = {**controls, **given.get("controls", {})}
    options = plugin.Options.model_validate(given)

    def opened() -> Device:
        device: Device = plugin.open(options, clock)
        return device

    return opened


def sink_names(tables: list[PluginTable]) -> list[str]:
    """The plugin's name, numbered where it is used twice: the names under which the outbox remembers who has what."""
    seen: Counter[str] = Counter()
    names = []
    for table in tables:
        seen[table.plugin] += 1
        names.append(table.plugin if seen[table.plugin] == 1 else f"{table.plugin}-{seen[table.plugin]}")
    return names
