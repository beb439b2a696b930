"""From the tables `[[triggers]]` and `[[actuators]]` to the parts that own these devices."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, TypeVar

from edge import registry
from edge.config import ActuatorTable, Config, PluginTable, TriggerTable
from edge.core.digital_io import Actuator, DiscoveredPort, Trigger
from edge.core.errors import DeviceNotFound
from edge.core.ports import Clock
from edge.gateway.digital_io.actuator_driver import ActuatorDriver
from edge.gateway.digital_io.station_io import IoAlarms, StationIo
from edge.gateway.digital_io.trigger_reader import TriggerReader
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.station_loop import StationLoop
from edge.gateway.status import StationStatus

__all__ = ["found_actuator", "found_trigger", "station_io"]

T = TypeVar("T", bound=PluginTable)


def station_io(
    config: Config, clock: Clock, status: StationStatus, calls: LoopCalls[StationLoop]
) -> StationIo:
    """The configured pedals, lights and relays, not yet started. Errors: ConfigError."""
    alarms = IoAlarms(status.io_alarm)
    readers = [_reader(table, name, clock, alarms, calls) for name, table in _named(config.triggers).items()]
    drivers = [_driver(table, name, clock, alarms) for name, table in _named(config.actuators).items()]
    return StationIo(readers, drivers, alarms)


def found_trigger(table: TriggerTable) -> str:
    """The pedal or button of this table, for a person. Errors: DeviceNotFound, ConfigError."""
    plugin = registry.trigger(table.plugin)
    return _found(table, plugin.discover(plugin.Options.model_validate(table.options)))


def found_actuator(table: ActuatorTable) -> str:
    """The light or relay of this table, for a person, with warnings. Errors: DeviceNotFound, ConfigError."""
    plugin = registry.actuator(table.plugin)
    warnings = [
        f"the pulse on channel {rule.channel} leaves out {', '.join(rule.passed_over)}: a reject gate lets these "
        "parts through; add them to `when`"
        for rule in (output.rule() for output in table.outputs)
        if rule.passed_over
    ]
    found = _found(table, plugin.discover(plugin.Options.model_validate(table.options)))
    return "; warning: ".join([found, *warnings])


def _found(table: PluginTable, discovered: Sequence[DiscoveredPort]) -> str:
    usable = [f"{one.product} at {one.place}" for one in discovered if one.refusal is None]
    if usable:
        return "; ".join(usable)
    seen = "; ".join(one.refusal for one in discovered if one.refusal)
    raise DeviceNotFound(
        f"nothing for '{table.plugin}' is plugged in"
        + (f" ({seen})" if seen else "; check the cable and the rights, then `gelgate devices`")
    )


def _named(tables: Sequence[T]) -> dict[str, T]:
    """Each with the name that its alarms carry: the plugin, numbered where it is used several times."""
    plugins = [table.plugin for table in tables]
    return {
        table.plugin if plugins.count(table.plugin) == 1 else f"{table.plugin} {number}": table
        for number, table in enumerate(tables, 1)
    }


def _reader(
    table: TriggerTable, name: str, clock: Clock, alarms: IoAlarms, calls: LoopCalls[StationLoop]
) -> TriggerReader:
    return TriggerReader(
        _trigger_opener(table, clock),
        clock,
        partial(calls.post, _ACTIONS[table.action]),
        partial(alarms.fault, "trigger_device", name),
        debounce_ns=round(table.debounce_ms * 1e6),
    )


def _driver(table: ActuatorTable, name: str, clock: Clock, alarms: IoAlarms) -> ActuatorDriver:
    return ActuatorDriver(
        _actuator_opener(table, clock),
        [output.rule() for output in table.outputs],
        clock,
        partial(alarms.fault, "actuator", name),
        partial(alarms.late, name),
        watchdog_ns=round(table.watchdog_s * 1e9),
    )


_ACTIONS: Final[dict[str, Callable[[StationLoop], None]]] = {
    "trigger": StationLoop.trigger,
    "acknowledge": StationLoop.acknowledge,
}


def _trigger_opener(table: TriggerTable, clock: Clock) -> Callable[[], Trigger]:
    plugin = registry.trigger(table.plugin)
    options = plugin.Options.model_validate(table.options)
    return lambda: plugin.open(options, clock)


def _actuator_opener(table: ActuatorTable, clock: Clock) -> Callable[[], Actuator]:
    plugin = registry.actuator(table.plugin)
    options = plugin.Options.model_validate(table.options)
    return lambda: plugin.open(options, clock)
