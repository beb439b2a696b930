"""From the tables `[[triggers]]` and `[[actuators]]` to the parts that own these devices."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from edge import registry
from edge.config import ActuatorTable, Config, PluginTable, TriggerTable
from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceNotFound
from edge.core.ports import Clock
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.stage import IoAlarms, Outputs
from edge.features.outputs.trigger_reader import TriggerReader
from edge.features.press_stage import Alarms

__all__ = ["describe_actuator", "describe_trigger", "open_outputs"]

T = TypeVar("T", bound=PluginTable)


def open_outputs(
    config: Config, clock: Clock, station: Alarms, actions: Mapping[str, Callable[[], None]]
) -> Outputs:
    """Make the configured pedals, lights and relays, not yet started. actions: of a trigger, by the word of its table.
    Errors: ConfigError."""
    alarms = IoAlarms(station.say)
    readers = [
        TriggerReader(
            _open_later(registry.trigger(table.plugin), table, clock),
            clock,
            actions[table.action],
            partial(alarms.fault, "trigger_device", name),
            debounce_ns=round(table.debounce_ms * 1e6),
        )
        for name, table in _label(config.triggers).items()
    ]
    drivers = [
        ActuatorDriver(
            _open_later(registry.actuator(table.plugin), table, clock),
            [output.rule() for output in table.outputs],
            clock,
            partial(alarms.fault, "actuator", name),
            partial(alarms.late, name),
            watchdog_ns=round(table.watchdog_s * 1e9),
        )
        for name, table in _label(config.actuators).items()
    ]
    return Outputs(readers, drivers, alarms, clock)


def _open_later(plugin: Any, table: PluginTable, clock: Clock) -> Callable[[], Any]:
    """Check the options now, and open the device when it is called. Errors: ConfigError."""
    return partial(plugin.open, plugin.Options.model_validate(table.options), clock)


def describe_trigger(table: TriggerTable) -> str:
    """The pedal or button of this table, for a person. Errors: DeviceNotFound, ConfigError."""
    plugin = registry.trigger(table.plugin)
    return _describe(table, plugin.discover(plugin.Options.model_validate(table.options)))


def describe_actuator(table: ActuatorTable) -> str:
    """The light or relay of this table, for a person, with warnings. Errors: DeviceNotFound, ConfigError."""
    plugin = registry.actuator(table.plugin)
    warnings = [
        f"the pulse on channel {rule.channel} leaves out {', '.join(rule.passed_over)}: a reject gate lets these "
        "parts through; add them to `when`"
        for rule in (output.rule() for output in table.outputs)
        if rule.passed_over
    ]
    found = _describe(table, plugin.discover(plugin.Options.model_validate(table.options)))
    return "; warning: ".join([found, *warnings])


def _describe(table: PluginTable, discovered: Sequence[DiscoveredPort]) -> str:
    usable = [f"{one.product} at {one.place}" for one in discovered if one.refusal is None]
    if usable:
        return "; ".join(usable)
    seen = "; ".join(one.refusal for one in discovered if one.refusal)
    raise DeviceNotFound(
        f"nothing for '{table.plugin}' is plugged in"
        + (f" ({seen})" if seen else "; check the cable and the rights, then `gelgate devices`")
    )


def _label(tables: Sequence[T]) -> dict[str, T]:
    """Each with the name that its alarms carry: the plugin, numbered where it is used several times."""
    plugins = [table.plugin for table in tables]
    return {
        table.plugin if plugins.count(table.plugin) == 1 else f"{table.plugin} {number}": table
        for number, table in enumerate(tables, 1)
    }
