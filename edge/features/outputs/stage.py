"""All pedals, lights and relays of a station: what they show, what they ask for, and their alarms.

They follow the presses of parts; master pieces and studies switch nothing.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, Self, final

from edge.config import Config
from edge.core.contact.events import Event, PressBegan, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.digital_io import StationView
from edge.core.ports import Clock
from edge.core.press import Press
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.opening import (
    IoAlarms,
    describe_actuator,
    describe_trigger,
    open_drivers,
    open_readers,
)
from edge.features.outputs.trigger_reader import TriggerReader
from edge.model.inspector import Inspector
from edge.press_stage import PressStage, StageParts
from edge.store.gel_ledger import GelRecord

__all__ = ["Outputs"]

# Nobody changes a part faster: a pass that is older than the last picture of the gel may be another part's.
UNSEEN_S: Final = 0.5


@final
class Outputs(PressStage):
    """The last stage: it shows what the others have decided."""

    def __init__(
        self,
        readers: Sequence[TriggerReader],
        drivers: Sequence[ActuatorDriver],
        alarms: IoAlarms,
        clock: Clock,
    ) -> None:
        self.readers, self.drivers, self._alarms, self._clock = tuple(readers), tuple(drivers), alarms, clock
        self._verdict: str | None = None
        self._awaited_ns: int | None = None
        self._seen_ns: int | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Open the configured pedals, lights and relays, not yet started. Errors: ConfigError."""
        config, clock, alarms = parts.config, parts.clock, IoAlarms(parts.alarms.say)
        outputs = cls((), open_drivers(config.actuators, clock, alarms), alarms, clock)
        actions: dict[str, Callable[[], None]] = {
            "trigger": parts.trigger,
            "acknowledge": partial(parts.post, outputs.acknowledge_all),
        }
        outputs.readers = tuple(open_readers(config.triggers, clock, alarms, actions))
        return outputs

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        for trigger in config.triggers:
            yield f"trigger {trigger.plugin}", partial(describe_trigger, trigger)
        for actuator in config.actuators:
            yield f"actuator {actuator.plugin}", partial(describe_actuator, actuator)

    def start(self) -> None:
        """Outputs first: they are then in the state `starting` before anything can be asked for."""
        for driver in self.drivers:
            driver.start()
        for reader in self.readers:
            reader.start()

    def close(self) -> None:
        """Switch to the outputs of the state `stopped`, and release every device."""
        for reader in self.readers:
            reader.close()
        for driver in self.drivers:
            driver.close()

    def show(self, view: StationView) -> None:
        """Show the state without the verdict; it is also the sign that the station's loop is alive.

        A station that does not inspect forgets the verdict: when it inspects again, it has judged nothing yet. While a
        contact does not end, or the sensor shows nothing, another part may lie on it, and no pass is shown.
        """
        if view.state != "ready":
            self._verdict = None
        is_unseen = self._seen_ns is not None and self._clock.monotonic_ns() - self._seen_ns > UNSEEN_S * 1e9
        if self._verdict == "pass" and (is_unseen or "contact" in view.alarms):
            self._verdict = None
        for driver in self.drivers:
            driver.show(replace(view, verdict=self._verdict))

    def see(self, event: Event) -> None:
        """When a press begins, no verdict of an earlier one is shown any more."""
        if isinstance(event, PressBegan):
            self._verdict, self._awaited_ns = None, None

    def look(self, look: Look) -> None:
        if look.sight.lost is None and look.sight.since_ns == look.timestamp_ns:
            self._seen_ns = self._clock.monotonic_ns()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Show the verdict before it is recorded; a pass has to wait for that."""
        if press.label is None and press.word == "pass":
            self._awaited_ns = press.judged_ns
        elif press.label is None:
            self._verdict, self._awaited_ns = press.word, None
            self._pulse(press)
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        """A pass is one now. It is shown unless another press has begun since."""
        if press.label is None and press.word == "pass":
            if press.judged_ns == self._awaited_ns:
                self._verdict = press.word
            self._pulse(press)

    def acknowledge(self, alarm: str) -> None:
        if alarm == "pulse":
            self._alarms.acknowledge()

    def acknowledge_all(self) -> None:
        """Take it that a person has seen the last verdict, and the pulses that were not given."""
        self._verdict, self._awaited_ns = None, None
        self._alarms.acknowledge()

    def _pulse(self, press: Press) -> None:
        """Deadlines count from the judged frame, or from now where there is none."""
        judged_ns = self._clock.monotonic_ns() if press.judged_ns is None else press.judged_ns
        for driver in self.drivers:
            driver.pulse(press.word, judged_ns)
