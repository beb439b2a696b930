"""The tables of a configuration that name a plugin: device, sinks, triggers, actuators and handshake."""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from edge.core.digital_io import Condition, OutputRule
from edge.core.ports import Clock

__all__ = [
    "ActuatorTable",
    "HandshakeTable",
    "OutputTable",
    "PlainText",
    "PluginTable",
    "SinkTable",
    "Table",
    "TriggerTable",
]


class Table(BaseModel):
    """One table of the file: unknown keys are refused, and the values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PluginTable(Table):
    """One plugin, chosen by name."""

    plugin: str = Field(description="its name")
    options: dict[str, Any] = Field(default_factory=dict, description="the options of that plugin")

    def opener(self, plugin: Any, clock: Clock) -> Callable[[], Any]:
        """Check the options now; return what opens the same device each time. Errors: ConfigError."""
        return partial(plugin.open, plugin.Options.model_validate(self.options), clock)


PlainText = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$")]


class SinkTable(PluginTable):
    """One receiver of results."""

    name: PlainText | None = Field(
        default=None,
        description="under which the outbox remembers what the receiver has; by default plugin and address",
    )


class TriggerTable(PluginTable):
    """A pedal or button."""

    action: Literal["trigger", "acknowledge", "good", "damaged"] = Field(
        default="trigger",
        description="trigger: score the press that is held now; acknowledge: a person has seen the last verdict, which "
        "goes off, and the alarm `pulse`; good, damaged: a person says so of the last press (`confirm_press`)",
    )
    debounce_ms: float = Field(
        default=40,
        ge=0,
        le=1000,
        description="it counts when it is held for this time, and released for it before",
    )


class OutputTable(Table):
    """What one channel of an actuator shows."""

    channel: int = Field(ge=1, le=64, description="the output, numbered from 1")
    when: tuple[Condition, ...] = Field(
        min_length=1,
        description="what switches it on: a state (starting, ready, halted, stopped), the last verdict while the "
        "station is ready (pass, fail, unsure, rejected, error), the contact (unknown, free, touching, pressing, "
        "deep_enough, at_rest, judged, lift, overload), `alarm` for any alarm, `gel` for a gel that is due",
    )
    safe: bool = Field(
        default=False,
        description="its level in a state that `when` does not name, except ready; also by watchdog",
    )
    pulse_ms: float | None = Field(
        default=None,
        gt=0,
        le=60_000,
        description="on for this time after a verdict, instead of until the next one",
    )
    deadline_ms: float | None = Field(
        default=None,
        gt=0,
        le=60_000,
        description="with pulse_ms: it starts within this time after the judged frame, which may be `settle_s` old "
        "when the press rests, or not at all: alarm `pulse`",
    )
    blink_ms: float | None = Field(
        default=None, ge=100, le=60_000, description="on and off for this time each, instead of steady"
    )

    @model_validator(mode="after")
    def _as_a_rule(self) -> "OutputTable":
        self.rule()
        return self

    def rule(self) -> OutputRule:
        """Make the rule for the driver."""
        return OutputRule(
            self.channel,
            frozenset(self.when),
            self.safe,
            _ns(self.pulse_ms),
            _ns(self.deadline_ms),
            _ns(self.blink_ms),
        )


def _ns(ms: float | None) -> int | None:
    return None if ms is None else round(ms * 1e6)


class ActuatorTable(PluginTable):
    """A relay board, light or buzzer. It is never a safety function."""

    watchdog_s: float = Field(
        default=5,
        ge=1,
        le=60,
        description="without a sign of life from the loop for this time its outputs go to those of the state halted",
    )
    outputs: list[OutputTable] = Field(min_length=1, description="what its channels show; one table each")

    @model_validator(mode="after")
    def _one_pulse_a_channel(self) -> "ActuatorTable":
        pulsed = {output.channel for output in self.outputs if output.pulse_ms is not None}
        for channel in pulsed:
            if sum(output.channel == channel for output in self.outputs) > 1:
                raise ValueError(
                    f"channel {channel} gives a pulse, so it has one output alone; use another channel"
                )
        return self


class HandshakeTable(PluginTable):
    """The handshake with a PLC: a trigger with an id, and the verdict of the press that answers it. See plc.md. A
    station has one sensor, so one."""

    timeout_s: float = Field(
        default=10,
        ge=0.1,
        le=3600,
        description="a trigger that no press answered within this time is done as an error, which is no pass",
    )
    watchdog_s: float | None = Field(
        default=None,
        ge=0.1,
        le=60,
        description="the PLC changes its watchdog at least this often; else its triggers are refused, no pass is "
        "shown, and the alarm `plc` is raised. None: it is not watched",
    )
