"""The status messages of a station: state, info, gel, alarms and stats."""

import logging
import threading
from collections.abc import Callable, Sequence
from typing import Final, Literal

from edge.acquisition import AcquisitionState, AcquisitionStatus
from edge.core.contact_state import ContactState
from edge.core.digital_io import StationView
from edge.core.gel_life import GelState
from edge.core.ports import Clock, DeviceIdentity, Message
from edge.core.sentence import Sentence, join_sentences
from edge.extras import find_version
from edge.messaging.alarm_payload import ALARMS, AlarmPayload, alarm_cleared, list_alarms
from edge.messaging.status_payloads import (
    GelPayload,
    InfoPayload,
    StatePayload,
    availability_message,
)
from edge.model.bundle import Bundle
from edge.model.manifest_facts import promise
from edge.store.gel_ledger import GelRecord

__all__ = ["StationStatus"]

log = logging.getLogger(__name__)

_HANGING: Final = Sentence("the station's loop does not answer; check its disks, then restart it")


class StationStatus:
    """Makes messages of the current status for `announce`, which sends only changes; the `Alarms` of all stages."""

    def __init__(self, announce: Callable[[Message], object], clock: Clock) -> None:
        self.announce = announce
        self._clock = clock
        self._lock = threading.RLock()  # the reader thread reports the sensor, the loop everything else
        self._faults: dict[str, Sentence] = {}
        self._blind: Sentence | None = None
        self._sensor_fault: Sentence | None = None
        self._raised: dict[str, tuple[Sentence, str]] = {}
        self._waiting_for: Sentence | None = None
        self._is_stopped = self._is_hanging = False
        self._unproven: Sentence | None = None
        self._contact: ContactState = "unknown"
        self._piece_id: str | None = None
        self._said: tuple[str, str | None, str | None] | None = None

    def set_waiting_for(self, what: Sentence | None) -> None:
        """The thing that the station waits for before it can inspect, None when it inspects."""
        with self._lock:
            self._waiting_for = what
            self._say_state()

    def set_hanging(self, is_hanging: bool) -> None:
        """Say that the loop does not answer, which inspects nothing meanwhile; False when it turns again."""
        with self._lock:
            if is_hanging != self._is_hanging:
                self._is_hanging = is_hanging
                if is_hanging:
                    log.error("%s", _HANGING)
                self._say_state()

    def set_fault(self, alarm: str, text: Sentence | None) -> bool:
        """Nothing can be inspected until it is None: an alarm, and the state. Returns whether it is newly raised."""
        with self._lock:
            before = self._faults.get(alarm)
            if text is not None:
                self._faults[alarm] = text
            elif before is not None:
                del self._faults[alarm]
            if text != before:
                self.say(alarm, text)
                self._say_state()
            return before is None and text is not None

    def sensor_changed(self, sensor: AcquisitionStatus) -> None:
        """Called from the reader thread, once per change."""
        with self._lock:
            if sensor.state is AcquisitionState.STREAMING:
                log.info("sensor %s delivers frames", sensor.identity.serial if sensor.identity else "?")
                self._sensor_fault = None
            elif sensor.state is AcquisitionState.FAULT:
                self._sensor_fault = Sentence(sensor.fault or "the sensor stopped without a reason")
                log.warning("%s", self._sensor_fault)
            self._say_device()

    def set_blind(self, reason: Sentence | None) -> None:
        """Say why the sensor's frames show nothing; None while they do. Frames alone do not end this fault."""
        with self._lock:
            self._blind = reason
            self._say_device()

    def _say_device(self) -> None:
        faults = [fault for fault in (self._sensor_fault, self._blind) if fault is not None]
        self.set_fault("device", join_sentences(faults))

    def stopped(self) -> None:
        """The intended end. Alarms of other packages end with it: at the next start a package may be gone, and then
        nobody knows what to clear."""
        with self._lock:
            for alarm in self._raised.keys() - ALARMS.keys():
                self.say(alarm, None)
            self._is_stopped = True
            self._say_state()

    def _say_state(self) -> None:
        word, reason = self._state()
        state = (word, reason, self._unproven)
        if state != self._said:
            self._said, time_ns = state, self._clock.time_ns()
            self.announce(availability_message(is_online=word != "stopped"))
            payload = StatePayload(time_ns=time_ns, state=word, reason=reason, unproven=self._unproven)
            self.announce(payload.message())

    def _state(self) -> tuple[Literal["starting", "ready", "halted", "stopped"], str | None]:
        if self._is_stopped:
            return "stopped", None
        if self._faults or self._is_hanging:
            return "halted", join_sentences([*self._faults.values(), *[_HANGING] * self._is_hanging])
        return (
            ("ready", None)
            if self._waiting_for is None
            else ("starting", Sentence(f"waiting for {self._waiting_for}"))
        )

    def say(
        self, alarm: str, sentence: Sentence | None, severity: Literal["warning", "error"] = "error"
    ) -> None:
        """Raise an alarm for a person, or clear it with None; what is said already is not said again. The log has it
        once, until it is cleared.

        One that no one declares is in the log, the stats and the lights alone: the fault of a feature stops no
        inspection, and no start would empty its topic.
        """
        with self._lock:
            if self._raised.get(alarm) == (sentence and (sentence, severity)):
                return
            is_declared = alarm in ALARMS or alarm in list_alarms()
            if sentence is None:
                del self._raised[alarm]
                if is_declared:
                    self.announce(alarm_cleared(alarm))
                return
            if alarm not in self._raised and not is_declared:
                log.error("alarm %s: %s (declare it in `alarms` of its feature)", alarm, sentence)
            elif alarm not in self._raised and alarm not in self._faults:
                # A fault is logged by the one who noticed it.
                log.warning("alarm %s: %s", alarm, sentence)
            self._raised[alarm] = sentence, severity
            if is_declared:
                time_ns = self._clock.time_ns()
                payload = AlarmPayload(time_ns=time_ns, alarm=alarm, text=sentence, severity=severity)
                self.announce(payload.message())

    def gel(self, gel: GelRecord) -> None:
        """The mounted gel, when there is no press to report it."""
        self.announce(GelPayload.of(gel, self._clock.time_ns()).message())
        self.gel_wear(gel)

    def gel_wear(self, gel: GelRecord) -> None:
        """An alarm while the gel is due or must be replaced."""
        if gel.state is GelState.GOOD:
            self.say("gel", None)
            return
        gel_id, made, limit = gel.gel_id, gel.presses, gel.limit_presses
        if gel.state is GelState.DUE:
            due = Sentence(f"gel {gel_id} is due: {made} of {limit} presses; then `gelgate gel replace`")
            self.say("gel", due, "warning")
            return
        over = Sentence(
            f"gel {gel_id} must be replaced: {made} of {limit} presses; then `gelgate gel replace`"
        )
        self.say("gel", over)

    def set_unproven(self, sentence: Sentence | None) -> None:
        with self._lock:
            self._unproven = sentence
            self._say_state()

    def show_contact(self, contact: ContactState) -> None:
        with self._lock:
            self._contact = contact

    def show_piece(self, piece_id: str | None) -> None:
        with self._lock:
            self._piece_id = piece_id

    def info(
        self,
        bundle: Bundle,
        identity: DeviceIdentity,
        parts: Sequence[str] = (),
        *,
        is_drawn_on: bool = False,
    ) -> None:
        """The installed software and the connected sensor. parts: that can be selected. is_drawn_on: whether regions
        are drawn at this station."""
        manifest, (x_mm, y_mm) = bundle.manifest, bundle.profile.mm_per_pixel
        payload = InfoPayload(
            time_ns=self._clock.time_ns(),
            gelgate_version=find_version("gelgate"),
            sensor_product=identity.product,
            sensor_serial=identity.serial,
            sensor_profile=manifest.profile.name,
            part=manifest.part,
            position=manifest.position,
            parts=tuple(parts),
            method=manifest.method,
            backbone=manifest.backbone.id if manifest.backbone else None,
            bundle_id=bundle.digest,
            revision=manifest.revision,
            threshold=manifest.threshold.value,
            false_alarms=promise(manifest.threshold),
            regions=(manifest.regions.describe() or None) if manifest.regions else None,
            region_names=tuple(region.name for region in manifest.regions.regions)
            if manifest.regions
            else (),
            field_mm=(manifest.region.width * x_mm, manifest.region.height * y_mm) if is_drawn_on else None,
            warnings=manifest.provenance.warnings,
        )
        self.announce(payload.message())

    def view(self) -> StationView:
        """The state, the raised alarms and the contact, for lights and relays."""
        with self._lock:
            state = self._state()[0]
            contact = self._contact if state == "ready" else "unknown"
            alarms = frozenset(self._raised)
            return StationView(state, alarms=alarms, contact=contact, piece_id=self._piece_id)

    def counts(self, findings: Sequence[str]) -> None:
        """An alarm for counts that had to be corrected; it stays until a person acknowledges it, over a restart too."""
        if findings:
            self.say("counts", Sentence("; ".join(findings)))
