"""From a configuration's tables to the parts that they name: the store, plugins, and whoever opens the sensor."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack

from edge import registry
from edge.config import Config, PluginTable, StationTable
from edge.core.plugins import PlaysRecording
from edge.core.ports import Clock, Device, Message, Sink
from edge.core.sink_context import OnCommand, Station, topic_root
from edge.messaging.payloads import StatePayload, state_message
from edge.recording.format import Recording
from edge.store.outbox import Bounds
from edge.store.press_store import Store

__all__ = ["device_opener", "open_sinks", "open_store", "played_recording", "sink_context"]


def open_store(config: Config) -> Store:
    bounds = Bounds(round(config.store.outbox_mb * 1e6), config.store.outbox_days * 86400)
    return Store(config.store.path, bounds, config.gel.limit_presses, config.gel.warn_fraction)


def sink_context(
    table: StationTable, birth: Callable[[], Sequence[Message]], on_command: OnCommand, clock: Clock
) -> Station:
    """What every sink is told: topics, client id, last will, first messages, and who answers commands."""
    lost = StatePayload(time_ns=clock.time_ns(), state="lost", reason="the gateway vanished without a word")
    return Station(
        root=topic_root(table.prefix, table.site, table.line, table.station),
        client_id=f"gelgate-{table.site}-{table.line}-{table.station}",
        will=state_message(lost),
        birth=birth,
        on_command=on_command,
    )


def open_sink(table: PluginTable, station: Station) -> Sink:
    plugin = registry.sink(table.plugin)
    return plugin.open(plugin.Options.model_validate(table.options), station)


def open_sinks(tables: list[PluginTable], station: Station, parts: ExitStack) -> dict[str, Sink]:
    """Every sink by the name of its lane; what is opened is closed with the other parts."""
    sinks: dict[str, Sink] = {}
    for name, chosen in zip(sink_names(tables), tables, strict=True):
        sinks[name] = sink = open_sink(chosen, station)
        parts.callback(sink.close)  # harmless after the publisher's own closing
    return sinks


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
