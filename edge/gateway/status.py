"""The status messages of a station: state, info, gel, alarms and stats."""

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from statistics import median
from typing import Literal

from edge.core.digital_io import StationView
from edge.core.gel import GelState
from edge.core.ports import Clock, DeviceIdentity, Message
from edge.gateway.acquisition import AcquisitionState, AcquisitionStatus
from edge.gateway.summary import Summary
from edge.messaging.alarm_payload import AlarmPayload, alarm_cleared, alarm_message
from edge.messaging.gel_payload import GelPayload, gel_message
from edge.messaging.status_payloads import (
    InfoPayload,
    StatePayload,
    StatsPayload,
    availability_message,
    info_message,
    state_message,
    stats_message,
)
from edge.model.bundle import Bundle
from edge.model.limit_facts import backbone_sentence, method_sentence
from edge.model.promise import promise
from edge.store.gel_ledger import GelRecord
from edge.store.outbox import OutboxStatus

__all__ = ["StationStatus"]

log = logging.getLogger(__name__)


class StationStatus:
    """Makes messages of the current status for `announce`, which sends only changes."""

    def __init__(self, announce: Callable[[Message], object], clock: Clock) -> None:
        self._announce = announce
        self._clock = clock
        self._started_ns = clock.monotonic_ns()
        self._lock = threading.Lock()  # the reader thread reports the sensor, the loop everything else
        self._faults: dict[str, str] = {}
        self._blind: str | None = None
        self._sensor_fault: str | None = None
        self._raised: set[str] = set()
        self._waiting_for: str | None = None
        self._is_stopped = False
        self._unproven: str | None = None
        self._said: tuple[str, str | None, str | None] | None = None
        self._drops_before: OutboxStatus | None = None
        self._drops_now: OutboxStatus | None = None

    def set_waiting_for(self, what: str | None) -> None:
        """The thing that the station waits for before it can inspect, None when it inspects."""
        with self._lock:
            self._waiting_for = what
            self._say_state()

    def set_fault(self, alarm: str, text: str) -> bool:
        """Nothing can be inspected until `clear_fault`: an alarm, and the state. Returns whether this is a change."""
        with self._lock:
            is_new = alarm not in self._faults
            if self._faults.get(alarm) != text:
                self._faults[alarm] = text
                self.alarm(alarm, text)
                self._say_state()
            return is_new

    def clear_fault(self, alarm: str) -> None:
        """The fault is over; other faults may remain."""
        with self._lock:
            if self._faults.pop(alarm, None) is not None:
                self.clear(alarm)
            self._say_state()

    def sensor_changed(self, sensor: AcquisitionStatus) -> None:
        """Called from the reader thread, once per change."""
        if sensor.state is AcquisitionState.STREAMING:
            log.info("sensor %s delivers frames", sensor.identity.serial if sensor.identity else "?")
            self._sensor_fault = None
        elif sensor.state is AcquisitionState.FAULT:
            self._sensor_fault = sensor.fault or "the sensor stopped without a reason"
            log.warning("%s", self._sensor_fault)
        self._say_device()

    def set_blind(self, reason: str | None) -> None:
        """Why the sensor's frames show nothing, None while they do. Frames alone do not end this fault."""
        self._blind = reason
        self._say_device()

    def _say_device(self) -> None:
        faults = [fault for fault in (self._sensor_fault, self._blind) if fault is not None]
        if faults:
            self.set_fault("device", "; ".join(faults))
        else:
            self.clear_fault("device")

    def contact(self, sentence: str | None, is_fault: bool) -> None:
        """An alarm while a contact lasts longer than the usual ones, and in the end a fault."""
        if sentence is None:
            if "contact" in self._raised:
                self.clear_fault("contact")
                self.clear("contact")
        elif is_fault:
            if self.set_fault("contact", sentence):
                log.error("%s", sentence)
        elif "contact" not in self._raised:
            self.alarm("contact", sentence, "warning")

    def overview_changed(self, camera: AcquisitionStatus, *, is_needed: bool) -> None:
        """Called from the thread of the overview camera, once per change. is_needed: without it presses are refused."""
        if camera.state is AcquisitionState.STREAMING:
            log.info(
                "overview camera %s delivers pictures", camera.identity.serial if camera.identity else "?"
            )
            self.clear("overview")
            return
        is_over = camera.state is AcquisitionState.ENDED
        fault = "the recording of the overview camera is over" if is_over else camera.fault
        if fault is not None:
            effect = "presses are refused" if is_needed else "results come without its still"
            self.alarm("overview", f"{fault}; until it is back {effect}", "error" if is_needed else "warning")

    def stopped(self) -> None:
        """The intended end."""
        with self._lock:
            self._is_stopped = True
            self._say_state()

    def _say_state(self) -> None:
        word, reason = self._state()
        said = (word, reason, self._unproven)
        if said != self._said:
            self._said, time_ns = said, self._clock.time_ns()
            self._announce(availability_message(is_online=word != "stopped"))
            payload = StatePayload(time_ns=time_ns, state=word, reason=reason, unproven=self._unproven)
            self._announce(state_message(payload))

    def _state(self) -> tuple[Literal["starting", "ready", "halted", "stopped"], str | None]:
        if self._is_stopped:
            return "stopped", None
        if self._faults:
            return "halted", " ".join(self._faults.values())
        return (
            ("ready", None) if self._waiting_for is None else ("starting", f"waiting for {self._waiting_for}")
        )

    def alarm(self, alarm: str, text: str, severity: Literal["warning", "error"] = "error") -> None:
        """Raise an alarm for a person. The log has it once, until it is cleared."""
        if (
            alarm not in self._raised and alarm not in self._faults
        ):  # a fault is logged by the one who found it
            log.warning("alarm %s: %s", alarm, text)
        self._raised.add(alarm)
        payload = AlarmPayload(time_ns=self._clock.time_ns(), alarm=alarm, text=text, severity=severity)
        self._announce(alarm_message(payload))

    def clear(self, alarm: str) -> None:
        """Clear the alarm."""
        self._raised.discard(alarm)
        self._announce(alarm_cleared(alarm))

    def gel(self, gel: GelRecord) -> None:
        """The mounted gel, when there is no press to report it."""
        self._announce(gel_message(GelPayload.of(gel, self._clock.time_ns())))
        self.gel_wear(gel)

    def gel_wear(self, gel: GelRecord) -> None:
        """An alarm while the gel is due or must be replaced."""
        if gel.state is GelState.GOOD:
            self.clear("gel")
            return
        word = "must be replaced" if gel.state is GelState.REPLACE else "is due"
        text = f"gel {gel.gel_id} {word}: {gel.presses} of {gel.limit_presses} presses; then `gelgate gel replace`"
        self.alarm("gel", text, "warning" if gel.state is GelState.DUE else "error")

    def gel_scars(self, blind: str | None, mark: str | None) -> None:
        """Alarms while scars of the gel hide too much of what is pressed, and while one place of it exceeds again and
        again."""
        for alarm, sentence in (("gel_scar", blind), ("gel_mark", mark)):
            if sentence is not None:
                self.alarm(alarm, sentence, "error" if alarm == "gel_scar" else "warning")
            elif alarm in self._raised:
                self.clear(alarm)

    def gel_proof(self, sentence: str | None, unproven: Literal["off", "warn", "refuse"]) -> None:
        """Why the bundle in use is not yet proven on the mounted gel, None where it is: in the state, and an alarm, or
        a fault."""
        with self._lock:
            self._unproven = sentence
            self._say_state()
        if sentence is None or unproven == "off":
            self.clear_fault("gel_proof")
            if "gel_proof" in self._raised:
                self.clear("gel_proof")
        elif unproven == "warn":
            self.alarm("gel_proof", sentence, "warning")
        elif self.set_fault("gel_proof", sentence):
            log.warning("%s", sentence)

    def info(self, bundle: Bundle, identity: DeviceIdentity, parts: Sequence[str] = ()) -> None:
        """The installed software and the connected sensor. parts: that can be selected."""
        manifest = bundle.manifest
        payload = InfoPayload(
            time_ns=self._clock.time_ns(),
            gelgate_version=version("gelgate"),
            sensor_product=identity.product,
            sensor_serial=identity.serial,
            sensor_profile=manifest.profile.name,
            part=manifest.part,
            position=manifest.position,
            parts=tuple(parts),
            method=manifest.method,
            method_choice=method_sentence(manifest.facts) or None,
            backbone=manifest.backbone.id if manifest.backbone else None,
            backbone_choice=backbone_sentence(manifest.facts) or None,
            bundle_id=bundle.digest,
            revision=manifest.revision,
            threshold=manifest.threshold.value,
            false_alarms=promise(manifest.threshold),
            warnings=manifest.provenance.warnings,
        )
        self._announce(info_message(payload))

    def stats(
        self,
        summary: Summary,
        sensor: AcquisitionStatus,
        outbox: OutboxStatus,
        receivers: Mapping[str, str] | None = None,
        disk_free_bytes: int | None = None,
        gel: GelRecord | None = None,
        ledger_head: str | None = None,
    ) -> None:
        """Counters since the start."""
        self._dropped(outbox)
        latencies = summary.latencies_ms
        payload = StatsPayload(
            time_ns=self._clock.time_ns(),
            uptime_s=(self._clock.monotonic_ns() - self._started_ns) / 1e9,
            frames=summary.frames.frames,
            frames_corrupt=summary.frames_corrupt,
            frames_stale=summary.frames_stale,
            frames_dropped=summary.frames.dropped,
            frames_late=summary.frames.late,
            delivered_fps=sensor.fps,
            presses=summary.presses,
            presses_interrupted=summary.frames.interrupted,
            verdicts=dict(summary.verdicts),
            reconnects=sensor.reconnects,
            latency_ms_p50=median(latencies) if latencies else None,
            latency_ms_max=max(latencies, default=None),
            outbox_rows=outbox.rows,
            outbox_bytes=outbox.bytes,
            outbox_refused=outbox.refused,
            dropped=dict(outbox.dropped),
            disk_free_bytes=disk_free_bytes,
            gel_presses=gel.presses if gel else None,
            gel_limit_presses=gel.limit_presses if gel else None,
            alarms=tuple(sorted(self._raised)),
            receivers=dict(receivers or {}),
            ledger_head=ledger_head,
        )
        self._announce(stats_message(payload))

    def disk(self, sentence: str | None) -> None:
        """An alarm while the disk of the database has little room."""
        if sentence is None:
            self.clear("disk")
        else:
            self.alarm("disk", sentence, "warning")

    def archive(self, fault: str | None) -> None:
        """An alarm while presses are not archived."""
        if fault is None:
            self.clear("archive")
        else:
            self.alarm("archive", f"presses are judged and not archived: {fault}", "warning")

    def press_again(self, sentence: str | None) -> None:
        """An alarm while a second press of a piece is missing."""
        if sentence is None:
            self.clear("press_again")
        else:
            self.alarm("press_again", sentence, "warning")

    def io_alarm(self, alarm: str, text: str | None) -> None:
        """Raise or clear an alarm of the digital inputs and outputs. Called from their threads."""
        with self._lock:
            if text is None:
                self.clear(alarm)
            else:
                self.alarm(alarm, text)

    def view(self) -> StationView:
        """The state and the raised alarms, for lights and relays."""
        with self._lock:
            return StationView(self._state()[0], alarms=frozenset(self._raised))

    def overload(self, sentence: str | None) -> None:
        """An alarm while this machine is too slow for its sensor."""
        if sentence is None:
            self.clear("overload")
        else:
            self.alarm("overload", sentence)

    def refused(self, count: int, errors: list[str]) -> None:
        """An alarm while refused messages are kept."""
        if count:
            self.alarm("refused", f"{count} messages were refused and are kept: {'; '.join(errors)}")
        else:
            self.clear("refused")

    def receivers(self, faults: Sequence[str]) -> None:
        """An alarm while receivers report faults that a person should correct."""
        if faults:
            self.alarm("receiver", "; ".join(faults), "warning")
        else:
            self.clear("receiver")

    def new_bundles(self, faults: Sequence[str]) -> None:
        """An alarm while a configured bundle cannot be used; the ones in use inspect."""
        if faults:
            self.alarm("bundle", "; ".join(faults))
        else:
            self.clear("bundle")

    def acknowledge_dropped(self) -> None:
        """A person has seen the alarm `outbox_full`: it is raised again by the next drop."""
        self._drops_before = self._drops_now
        self.clear("outbox_full")

    def counts(self, findings: Sequence[str]) -> None:
        """An alarm for counts that had to be corrected; it stays until a person acknowledges it, or a restart."""
        if findings:
            self.alarm("counts", "; ".join(findings))

    def _dropped(self, outbox: OutboxStatus) -> None:
        """Drops since this process started are an alarm; older ones were published before."""
        self._drops_now = outbox
        if self._drops_before is None:
            self._drops_before = outbox
        aged = _since(self._drops_before.aged, outbox.aged)
        crowded = _since(aged, _since(self._drops_before.dropped, outbox.dropped))
        words = [*_words(aged, "too old"), *_words(crowded, "no room")]
        if words:
            self.alarm("outbox_full", f"unsent messages were dropped: {', '.join(words)}")


def _since(before: Mapping[str, int], now: Mapping[str, int]) -> dict[str, int]:
    return {kind: n - before.get(kind, 0) for kind, n in now.items()}


def _words(counts: Mapping[str, int], why: str) -> list[str]:
    return [f"{n} of kind {kind} ({why})" for kind, n in counts.items() if n]
