"""All pedals, lights and relays of a station, for its loop: what they show, what they ask for, and their alarms."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

from edge.core.digital_io import StationView
from edge.gateway.digital_io.actuator_driver import ActuatorDriver
from edge.gateway.digital_io.trigger_reader import TriggerReader

__all__ = ["IoAlarms", "StationIo"]

log = logging.getLogger(__name__)


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
        self._late.clear()
        self._say("pulse", None)


class StationIo:
    """Started and closed with the station; the loop uses the rest."""

    def __init__(
        self,
        readers: Sequence[TriggerReader] = (),
        drivers: Sequence[ActuatorDriver] = (),
        alarms: IoAlarms | None = None,
    ) -> None:
        self.readers, self.drivers, self._alarms = tuple(readers), tuple(drivers), alarms
        self._verdict: str | None = None
        self._awaited_ns: int | None = None

    def start(self) -> None:
        """Outputs first: they are then in the state `starting` before anything can be asked for."""
        for driver in self.drivers:
            driver.start()
        for reader in self.readers:
            reader.start()

    def turn(self, view: StationView) -> None:
        """What the station is now, without the verdict; also the sign that its loop is alive.

        A station that does not inspect forgets the verdict: when it inspects again, it has judged nothing yet. While a
        contact does not end, another part may lie on the sensor, and no pass is shown.
        """
        if view.state != "ready":
            self._verdict = None
        if "contact" in view.alarms:
            self.forget_pass()
        for driver in self.drivers:
            driver.show(replace(view, verdict=self._verdict))

    def began(self) -> None:
        """A press begins: from here on no verdict of an earlier one is shown."""
        self._forget()

    def forget_pass(self) -> None:
        """Stop showing a pass: the sensor shows nothing, so another part may lie on it."""
        if self._verdict == "pass":
            self._verdict = None

    def judged(self, verdict: str, judged_ns: int) -> None:
        """A press was judged, and is not recorded yet. A pass has to wait for `recorded`."""
        if verdict == "pass":
            self._awaited_ns = judged_ns
        else:
            self._verdict = verdict
            self._pulse(verdict, judged_ns)

    def recorded(self, verdict: str, judged_ns: int) -> None:
        """A press is in the database: a pass is one now. It is shown unless another press has begun since."""
        if verdict != "pass":
            return
        if judged_ns == self._awaited_ns:
            self._verdict = verdict
        self._pulse(verdict, judged_ns)

    def acknowledge(self) -> None:
        """A person has seen the last verdict, and the pulses that were not given."""
        self._forget()
        self.acknowledge_pulses()

    def acknowledge_pulses(self) -> None:
        """A person has seen the pulses that were not given."""
        if self._alarms is not None:
            self._alarms.acknowledge()

    def close(self) -> None:
        """Switch to the outputs of the state `stopped`, and release every device. May be called again."""
        for reader in self.readers:
            reader.close()
        for driver in self.drivers:
            driver.close()

    def _forget(self) -> None:
        self._verdict, self._awaited_ns = None, None

    def _pulse(self, verdict: str, judged_ns: int) -> None:
        for driver in self.drivers:
            driver.pulse(verdict, judged_ns)
