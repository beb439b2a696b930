"""All pedals, lights and relays of a station: what they show, what they ask for, and their alarms.

They follow the presses of parts; master pieces and studies switch nothing.
"""

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, Self, TypeVar, final

from edge import registry
from edge.config import ActuatorTable, Config, PluginTable
from edge.core.contact.events import Event, PressBegan, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.digital_io import DiscoveredPort, StationView
from edge.core.errors import DeviceNotFound, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.person_verdict import Saying
from edge.core.ports import Clock
from edge.core.press import Press
from edge.core.sentence import Sentence, join_sentences
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.trigger_reader import TriggerReader
from edge.model.inspector import Inspector
from edge.press_stage import PressStage, StageParts
from edge.store.acts import CONFIRM, Act
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import Store

__all__ = ["Outputs", "describe_actuator"]

log = logging.getLogger(__name__)

T = TypeVar("T", bound=PluginTable)

# Nobody changes a part faster: a pass that is older than the last picture of the gel may be another part's.
UNSEEN_S: Final = 0.5


@final
class Outputs(PressStage):
    """The last stage: it shows what the others have decided."""

    is_awaited = True

    def __init__(self, say: Callable[[str, Sentence | None], None], clock: Clock) -> None:
        self.readers: Sequence[TriggerReader] = ()
        self.drivers: Sequence[ActuatorDriver] = ()
        self._say, self._clock = say, clock
        self._verdict: str | None = None
        self._piece_id: str | None = None
        self._awaited_ns: int | None = None
        self._came_ns: int | None = None  # the newest frame, with a time of its own
        self._seen_ns: int | None = None
        self._taken_ns: int | None = None  # when the newest frame came, or was made
        self._judged_id: str | None = None
        self._recorded_id: str | None = None
        self._faults: dict[str, dict[str, str]] = {"trigger_device": {}, "actuator": {}}
        self._lock = threading.Lock()  # of the faults and the late pulses, which each owner's thread reports
        self._late: Counter[str] = Counter()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Open the configured pedals, lights and relays, not yet started. Errors: ConfigError."""
        outputs = cls(parts.alarms.say, parts.clock)
        actions: dict[str, Callable[[], None]] = {
            "trigger": parts.trigger,
            "acknowledge": partial(parts.post, outputs.acknowledge_all),
            "good": partial(parts.post, partial(outputs.confirm_last, "good", parts.store)),
            "damaged": partial(parts.post, partial(outputs.confirm_last, "damaged", parts.store)),
        }
        outputs.drivers = [
            ActuatorDriver(
                table.opener(registry.actuator(table.plugin), parts.clock),
                [output.rule() for output in table.outputs],
                parts.clock,
                partial(outputs.note_fault, "actuator", name),
                partial(outputs.note_late, name),
                watchdog_ns=round(table.watchdog_s * 1e9),
            )
            for name, table in _label(parts.config.actuators).items()
        ]
        outputs.readers = [
            TriggerReader(
                table.opener(registry.trigger(table.plugin), parts.clock),
                parts.clock,
                actions[table.action],
                partial(outputs.note_fault, "trigger_device", name),
                debounce_ns=round(table.debounce_ms * 1e6),
            )
            for name, table in _label(parts.config.triggers).items()
        ]
        return outputs

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        for trigger in config.triggers:
            yield f"trigger {trigger.plugin}", partial(_describe, trigger, registry.trigger)
        for actuator in config.actuators:
            yield f"actuator {actuator.plugin}", partial(describe_actuator, actuator)

    def note_fault(self, alarm: str, name: str, fault: str | None) -> None:
        """The device of that name cannot be used, or with None can again. The owner threads call it."""
        with self._lock:
            faults = {**self._faults[alarm], name: fault}
            self._faults[alarm] = {key: text for key, text in faults.items() if text is not None}
            self._say(
                alarm, join_sentences(f"{key}: {one}" for key, one in sorted(self._faults[alarm].items()))
            )

    def note_late(self, name: str, sentence: str) -> None:
        """A pulse was not given in time. It stays an alarm until a person acknowledges it, or a restart."""
        log.error("%s: %s", name, sentence)
        with self._lock:
            self._late[name] += 1
            self._say(
                "pulse",
                Sentence(
                    f"{self._late.total()} pulses were not given in time; a part may have passed. The last one: "
                    f"{name}: {sentence}"
                ),
            )

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

        A station that does not inspect forgets the verdict, and a pass that is not recorded yet: when it inspects
        again, it has judged nothing yet. While a contact does not end, or the sensor shows nothing, another part may
        lie on it, and no pass is shown; nor while the newest frame is so old, as after a turn that took long. When a
        piece of several places is begun, nothing of the one before is shown.
        """
        now_ns = self._clock.monotonic_ns()
        if view.state != "ready":
            self._verdict, self._awaited_ns = None, None
        is_unseen = self._seen_ns is not None and now_ns - self._seen_ns > UNSEEN_S * 1e9
        is_other_piece = view.piece_id not in (None, self._piece_id)
        if is_other_piece or (self._verdict == "pass" and (is_unseen or "contact" in view.alarms)):
            self._verdict = None
        is_late = self._taken_ns is not None and now_ns - self._taken_ns > UNSEEN_S * 1e9
        verdict = None if self._verdict == "pass" and is_late else self._verdict
        for driver in self.drivers:
            driver.show(replace(view, verdict=verdict))

    def take(self, frame: CameraFrame) -> None:
        self._came_ns = None if frame.is_on_demand else frame.timestamp_ns
        self._taken_ns = self._came_ns or self._clock.monotonic_ns()

    def see(self, event: Event) -> None:
        """When a press begins, no verdict of an earlier one is shown any more."""
        if isinstance(event, PressBegan):
            self._verdict, self._awaited_ns = None, None

    def look(self, look: Look) -> None:
        if look.interruption_s > UNSEEN_S and self._verdict == "pass":  # also where the loop did not look
            self._verdict = None
        if look.sight.seen_ns == look.timestamp_ns:
            self._seen_ns = self._clock.monotonic_ns()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Show the verdict before it is recorded; a pass has to wait for that."""
        self._judged_id = press.press_id
        if press.label is None:
            self._piece_id = None if press.piece is None else press.piece.piece_id
        if press.label is None and press.word == "pass":
            self._awaited_ns = press.judged_ns
        elif press.label is None:
            self._verdict, self._awaited_ns = press.word, None
            self._pulse(press)
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        """A pass is one now. It is shown unless another press has begun since."""
        self._recorded_id = press.press_id if press.label is None else None
        if press.label is None and press.word == "pass":
            if press.judged_ns == self._awaited_ns:
                self._verdict = press.shown
            self._pulse(press)

    def acknowledge(self, alarm: str) -> None:
        if alarm == "pulse":
            with self._lock:
                self._late.clear()
                self._say("pulse", None)

    def acknowledge_all(self) -> None:
        """Take it that a person has seen the last verdict, and the pulses that were not given."""
        self._verdict, self._awaited_ns = None, None
        self.acknowledge("pulse")

    def confirm_last(self, saying: Saying, store: Store) -> None:
        """A person says at a pedal what the last press was. No one waits for an answer, so what fails is in the log."""
        if self._recorded_id is None or self._recorded_id != self._judged_id:
            log.warning("a pedal says '%s', and the last press is none of a part that is recorded", saying)
            return
        given = {"press_id": self._recorded_id, "verdict": saying}
        try:
            store.begin_act(Act(self._clock.time_ns(), "pedal", CONFIRM, None, given, outcome="done"))
        except StoreError as error:
            log.error("what a pedal says of press %s is not kept: %s", self._recorded_id, error)

    def _pulse(self, press: Press) -> None:
        """Deadlines count from the judged frame, where there is none from the one that has decided the press, and from
        now where that has a recorded time."""
        decided_ns = press.judged_ns or self._came_ns or self._clock.monotonic_ns()
        if press.shown is not None:
            for driver in self.drivers:
                driver.pulse(press.shown, decided_ns)


def describe_actuator(table: ActuatorTable) -> str:
    """Describe the light or relay of this table, with warnings. Errors: DeviceNotFound, ConfigError."""
    warnings = [
        f"the pulse on channel {rule.channel} leaves out {', '.join(rule.passed_over)}: a reject gate lets these "
        "parts through; add them to `when`"
        for rule in (output.rule() for output in table.outputs)
        if rule.passed_over
    ]
    return "; warning: ".join([_describe(table, registry.actuator), *warnings])


def _describe(table: PluginTable, find: Callable[[str], Any]) -> str:
    """Describe the device of this table, for a person. Errors: DeviceNotFound, ConfigError."""
    plugin = find(table.plugin)
    discovered: Sequence[DiscoveredPort] = plugin.discover(plugin.Options.model_validate(table.options))
    usable = [f"{device.product} at {device.place}" for device in discovered if device.refusal is None]
    if usable:
        return "; ".join(usable)
    seen = "; ".join(device.refusal for device in discovered if device.refusal)
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
