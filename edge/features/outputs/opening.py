"""From the tables `[[triggers]]` and `[[actuators]]` to the parts that own these devices."""

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from edge import registry
from edge.config import ActuatorTable, PluginTable, TriggerTable
from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceNotFound
from edge.core.ports import Clock
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.trigger_reader import TriggerReader

__all__ = ["IoAlarms", "describe_actuator", "describe_trigger", "open_drivers", "open_readers"]

log = logging.getLogger(__name__)

T = TypeVar("T", bound=PluginTable)


class IoAlarms:
    """The alarms `trigger_device`, `actuator` and `pulse`, of all devices together. The owner threads call it.

    say: raises the alarm with a text, or clears it with None.
    """

    def __init__(self, say: Callable[[str, str | None], None]) -> None:
        self._say = say
        self._faults: dict[str, dict[str, str]] = {"trigger_device": {}, "actuator": {}}
        self._late: Counter[str] = Counter()

    def fault(self, alarm: str, name: str, fault: str | None) -> None:
        """The device of that name cannot be used, or with None can again."""
        found = {**self._faults[alarm], name: fault}
        self._faults[alarm] = {key: text for key, text in found.items() if text is not None}
        text = "; ".join(f"{key}: {one}" for key, one in sorted(self._faults[alarm].items()))
        self._say(alarm, text or None)

    def late(self, name: str, sentence: str) -> None:
        """A pulse was not given in time. It stays an alarm until a person acknowledges it, or a restart."""
        self._late[name] += 1
        count = sum(self._late.values())
        log.error("%s: %s", name, sentence)
        text = (
            f"{count} pulses were not given in time; a part may have passed. The last one: {name}: {sentence}"
        )
        self._say("pulse", text)

    def acknowledge(self) -> None:
        """A person has seen the pulses that were not given."""
        if self._late:
            self._late.clear()
            self._say("pulse", None)


def open_readers(
    tables: Sequence[TriggerTable], clock: Clock, alarms: IoAlarms, actions: Mapping[str, Callable[[], None]]
) -> list[TriggerReader]:
    """Make the configured pedals. actions: of a trigger, by the word of its table. Errors: ConfigError."""
    return [
        TriggerReader(
            _open_later(registry.trigger(table.plugin), table, clock),
            clock,
            actions[table.action],
            partial(alarms.fault, "trigger_device", name),
            debounce_ns=round(table.debounce_ms * 1e6),
        )
        for name, table in _label(tables).items()
    ]


def open_drivers(tables: Sequence[ActuatorTable], clock: Clock, alarms: IoAlarms) -> list[ActuatorDriver]:
    """Make the configured lights and relays. Errors: ConfigError."""
    return [
        ActuatorDriver(
            _open_later(registry.actuator(table.plugin), table, clock),
            [output.rule() for output in table.outputs],
            clock,
            partial(alarms.fault, "actuator", name),
            partial(alarms.late, name),
            watchdog_ns=round(table.watchdog_s * 1e9),
        )
        for name, table in _label(tables).items()
    ]


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
