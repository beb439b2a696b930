"""From a configuration's tables to the parts that they name: the store, plugins, and whoever opens the sensor."""

from collections import Counter
from collections.abc import Callable, Mapping

from edge import registry
from edge.config import Config, PluginTable
from edge.core.plugins import PlaysRecording
from edge.core.ports import Clock, Device, Sink
from edge.core.sink_context import Station
from edge.recording.format import Recording
from edge.store.outbox import Bounds
from edge.store.press_store import Store

__all__ = ["device_opener", "open_sink", "open_store", "played_recording", "sink_names"]


def open_store(config: Config) -> Store:
    bounds = Bounds(round(config.store.outbox_mb * 1e6), config.store.outbox_days * 86400)
    return Store(config.store.path, bounds, config.gel.limit_presses, config.gel.warn_fraction)


def open_sink(table: PluginTable, station: Station) -> Sink:
    plugin = registry.sink(table.plugin)
    return plugin.open(plugin.Options.model_validate(table.options), station)


def device_opener(table: PluginTable, controls: Mapping[str, int], clock: Clock) -> Callable[[], Device]:
    """Opens the configured device, the same one each time.

    Camera controls are those of the bundle's sensor profile; the configuration may set some of them otherwise.
    """
    plugin = registry.device(table.plugin)
    given = dict(table.options)
    if "controls" in plugin.Options.model_fields:
        given["controls"] = {**controls, **given.get("controls", {})}
    options = plugin.Options.model_validate(given)

    return lambda: plugin.open(options, clock)


def played_recording(table: PluginTable) -> Recording | None:
    """The recording that the configured device plays; None where it is a sensor. Errors: RecordingError."""
    plugin = registry.device(table.plugin)
    options = plugin.Options.model_validate(table.options)
    return Recording.open(plugin.recording(options)) if isinstance(plugin, PlaysRecording) else None


def sink_names(tables: list[PluginTable]) -> list[str]:
    """The plugin's name, numbered where it is used twice: the names under which the outbox remembers who has what."""
    seen: Counter[str] = Counter()
    names = []
    for table in tables:
        seen[table.plugin] += 1
        names.append(table.plugin if seen[table.plugin] == 1 else f"{table.plugin}-{seen[table.plugin]}")
    return names
