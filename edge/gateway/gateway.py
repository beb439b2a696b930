"""The composition root: the only place that knows which parts exist. Built in order, closed in reverse.

One thread reads the sensor, one per sink publishes, and the thread that calls `run` does everything between: contact,
score, verdict, and the one transaction that counts a press and queues its messages.
"""

import logging
import random
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Final, Self

from edge.config import Config
from edge.core.contact.events import Event, ReferenceReady, ReferenceRefreshed, StartedTouched
from edge.core.contact.rules import ContactSettings
from edge.core.contact.wear import wear
from edge.core.errors import BundleMismatch, DeviceNotFound, RecordingEnded, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import QualitySettings
from edge.core.ports import Clock, DeviceIdentity, Sink
from edge.core.press_detector import PressDetector
from edge.core.sink_context import Place
from edge.gateway.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.gateway.commands import Commands
from edge.gateway.inspector import Inspection, Inspector
from edge.gateway.loop_calls import Requests
from edge.gateway.overload import OverloadRule
from edge.gateway.parts import device_opener, open_sinks, open_store, sink_context
from edge.gateway.press_pipeline import PressTaker
from edge.gateway.recorder import PressReport, Recorder
from edge.gateway.status import Reporter, Summary
from edge.messaging.payloads import NoArguments, ReplaceGelArguments
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.retained_state import Announcements
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.gel_ledger import GelRecord
from edge.store.reference_files import ReferenceFolder

__all__ = ["Gateway", "Summary"]

log = logging.getLogger(__name__)

# The loop looks up from waiting for a frame this often, to serve commands and notice faults.
WAIT_S: Final = 0.2
STATS_EVERY_S: Final = 10.0
# A frame older than this when it is looked at could not be judged any more.
LATE_NS: Final = round(QualitySettings().max_age_s * 1e9)
# How long a store that refuses writes is left alone before it is tried again.
STORE_RETRY_S: Final = 1.0
# What is waited for before anything is inspected.
FREE_GEL: Final = "the free gel, to learn its picture"

OnPress = Callable[[PressReport], None]


class Gateway:
    """A running station. `open` builds it, `run` inspects until told to stop, `close` takes it down.

    Errors of `open`: ConfigError, BundleError, StoreError. A sensor that is not there is a fault while running, not an
    error: it is announced, and waited for.
    """

    def __init__(self, config: Config, clock: Clock, on_press: OnPress = lambda report: None) -> None:
        self.summary = Summary()
        self._config = config
        self._clock = clock
        self._on_press = on_press
        self._parts = ExitStack()
        self._stop = threading.Event()
        self._requests = Requests()
        self._dropped_before = 0
        self._overload = OverloadRule()
        self._was_held_up = False
        self._last_stats_ns = clock.monotonic_ns()
        self._taker: PressTaker | None = None
        self._recorder: Recorder | None = None
        self._gel: GelRecord | None = None

    @classmethod
    def open(cls, config: Config, clock: Clock, on_press: OnPress = lambda report: None) -> Self:
        """Build every part; what cannot work is refused here, before anything is started."""
        gateway = cls(config, clock, on_press)
        try:
            gateway._build()
        except BaseException:
            gateway.close()
            raise
        return gateway

    def run(self, stop: threading.Event, *, presses: int | None = None) -> Summary:
        """Inspect until `stop` is set, a recording ends, or so many presses were recorded."""
        self._stop = stop
        self._publisher.start()
        self._acquisition.start()
        try:
            while not stop.is_set() and (presses is None or self.summary.presses < presses):
                self._turn()
        except RecordingEnded as end:
            self.summary.has_ended = True
            log.info("%s", end)
        finally:
            self._requests.close()
        self._say_stats()
        return self.summary

    @property
    def status(self) -> AcquisitionStatus:
        """How the sensor is doing."""
        return self._acquisition.status

    def close(self) -> None:
        """Take the parts down in reverse; unsent messages stay in the outbox. Harmless when repeated."""
        self._parts.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Building

    def _build(self) -> None:
        config = self._config
        bundle = Bundle.load(config.inspection.bundle)
        scorer = Scorer(bundle, threads=config.inspection.threads)
        scorer.check_golden()
        self._inspector = Inspector(scorer, self._clock)
        self._store = self._parts.enter_context(open_store(config))
        self._references = ReferenceFolder(config.store.path.with_suffix(".references"))
        self._announcements = Announcements()
        # The lock before the sinks: a second gateway would push this one off the broker before it is refused.
        lock = PublisherLock(config.store.path)
        self._parts.callback(lock.close)
        self._publisher = Publisher(
            config.store.path,
            self._open_sinks(),
            self._announcements,
            self._clock,
            random.Random(),
            lock=lock,
        )
        self._reporter = Reporter(self._publisher.announce, self._clock)
        self._parts.callback(self._stop_publishing)
        self._reporter.awaits("the sensor")
        self._acquisition = Acquisition(
            device_opener(config.device, bundle.profile.controls, self._clock),
            self._clock,
            self._device_changed,
        )
        self._parts.callback(self._acquisition.close)

    def _open_sinks(self) -> dict[str, Sink]:
        verbs = {
            "trigger": self._on_trigger,
            "relearn": self._on_relearn,
            "replace_gel": self._on_replace_gel,
        }
        commands = Commands(verbs, self._clock)
        station = sink_context(self._config.station, self._announcements.all, commands, self._clock)
        return open_sinks(self._config.sinks, station, self._parts)

    def _stop_publishing(self) -> None:
        self._reporter.stopped()
        self._publisher.stop()

    # The loop

    def _turn(self) -> None:
        frame = self._acquisition.next(WAIT_S)
        self._requests.serve()
        if frame is not None:
            self._look_at(frame)
        if self._clock.monotonic_ns() - self._last_stats_ns > STATS_EVERY_S * 1e9:
            self._say_stats()

    def _look_at(self, frame: CameraFrame) -> None:
        taker = self._taker or self._begun()
        if taker is None:
            return
        self._count(frame, taker)
        self._record_all(taker.feed(frame))

    def _count(self, frame: CameraFrame, taker: PressTaker) -> None:
        """Note what this machine was too slow for."""
        counts, dropped = self.summary.frames, self._acquisition.status.dropped
        age_ns = self._clock.monotonic_ns() - frame.timestamp_ns
        was_interrupted = dropped > self._dropped_before and taker.tracker.has_contact
        self._dropped_before = dropped
        self.summary.frames = replace(
            counts,
            late=counts.late + (age_ns > LATE_NS),
            interrupted=counts.interrupted + was_interrupted,
        )

    def _begun(self) -> PressTaker | None:
        """The first frame: now the sensor is known, and with it the gel that is being worn.

        None while the store refuses: the next frame tries again.
        """
        identity = self._acquisition.status.identity
        if identity is None:
            raise DeviceNotFound("a frame arrived from a sensor that has not said who it is")
        self._check_mode(identity)
        try:
            gel = self._store.gel(identity.serial, self._clock.time_ns())
        except StoreError as error:
            self._store_refuses(error)
            self._stop.wait(STORE_RETRY_S)
            return None
        self._reporter.mended("store")
        settings = ContactSettings(is_external=self._config.inspection.trigger == "command")
        stored = self._references.load(identity.serial, gel.gel_id, "last")
        detector = PressDetector(self._inspector.bundle.profile, settings, stored)
        self._taker = PressTaker(detector, self._inspector, self._clock, self._contact_said)
        table = self._config.station
        place = Place(table.site, table.line, table.station)
        self._recorder = Recorder(self._store, self._inspector, identity.serial, place, self._clock)
        self._mounted(gel)
        self._reporter.info(self._inspector.bundle, identity)
        self._reporter.awaits(FREE_GEL)
        return self._taker

    def _check_mode(self, identity: DeviceIdentity) -> None:
        bundle = self._inspector.bundle
        (w, h), (found_w, found_h) = bundle.profile.native, identity.mode
        if identity.mode != bundle.profile.native:
            raise BundleMismatch(
                f"bundle {bundle.where} was made from {w}x{h} frames (profile {bundle.profile.name}), sensor "
                f"{identity.serial} sends {found_w}x{found_h}; use a bundle made for this sensor's mode"
            )

    def _record_all(self, inspections: list[Inspection]) -> None:
        for inspection in inspections:
            self._record(inspection)

    def _record(self, inspection: Inspection) -> None:
        """Write one press, however long the disk refuses; nothing else is inspected meanwhile."""
        assert self._recorder is not None
        judged = self._recorder.prepare(inspection)
        while True:
            try:
                report = self._recorder.record(judged)
                break
            except StoreError as error:
                self._store_refuses(error)
                if self._stop.wait(STORE_RETRY_S):
                    raise
        self._reporter.mended("store")
        self._publisher.wake()
        self.summary.add(report)
        if self._gel is not None and report.gel.gel_id != self._gel.gel_id:
            self._replaced(report.gel)
        self._gel = report.gel
        self._reporter.gel_wear(report.gel)
        self._on_press(report)

    def _mounted(self, gel: GelRecord) -> None:
        self._gel = gel
        self._reporter.gel(gel)

    def _replaced(self, gel: GelRecord) -> None:
        """Another gel is mounted: what the old one looked like says nothing any more."""
        assert self._recorder is not None
        self._mounted(gel)
        self._recorder.wear_index = None
        self._relearn()

    def _relearn(self) -> None:
        if self._taker is not None:
            self._reporter.awaits(FREE_GEL)
            self._record_all(self._taker.relearn())

    # What is announced

    def _device_changed(self, status: AcquisitionStatus) -> None:
        """Called from the reader thread, once per change."""
        if status.state is AcquisitionState.STREAMING:
            log.info("sensor %s delivers frames", status.identity.serial if status.identity else "?")
            self._reporter.mended("device")
        elif status.state is AcquisitionState.FAULT:
            reason = status.fault or "the sensor stopped without saying why"
            log.warning("%s", reason)
            self._reporter.fault("device", reason)

    def _store_refuses(self, error: StoreError) -> None:
        self._was_held_up = True
        if self._reporter.fault("store", str(error)):
            log.error("%s", error)

    def _contact_said(self, event: Event) -> None:
        log.debug("%s", event)
        match event:
            case StartedTouched():
                log.warning("something presses the gel at the start; nothing is inspected until it is free")
                self._reporter.awaits(f"{FREE_GEL}; something presses it")
            case ReferenceReady():
                self._reporter.awaits(None)
                self._see_wear()
            case ReferenceRefreshed():
                self._see_wear()

    def _see_wear(self) -> None:
        """The free gel was seen: keep its picture, and compare it with the first of this gel."""
        reference = self._taker.tracker.reference if self._taker else None
        if reference is None or self._gel is None or self._recorder is None:
            return
        serial, gel_id = self._gel.serial, self._gel.gel_id
        self._references.save(serial, gel_id, reference)
        first = self._references.load(serial, gel_id, "first")
        if first is not None and first.view.shape == reference.view.shape:
            self._recorder.wear_index = wear(first.view, reference.view).index

    def _say_stats(self) -> None:
        self._last_stats_ns = self._clock.monotonic_ns()
        self.summary.see(self._acquisition.status, self._taker.detector.corrupt if self._taker else 0)
        self._see_load()
        try:
            self._see_gel()
            outbox = self._publisher.outbox_status()
        except StoreError as error:
            self._store_refuses(error)
            return
        self._reporter.mended("store")
        self._reporter.stats(self.summary, self._acquisition.status, outbox)
        errors = [c.last_error for c in self._publisher.counters().values() if c.refused]
        self._reporter.refused(outbox.refused, errors)

    def _see_load(self) -> None:
        """Frames that a refusing store cost have their own alarm."""
        if self._was_held_up:
            self._overload.skip(self.summary.frames)
            self._was_held_up = False
        self._reporter.overload(self._overload.step(self.summary.frames))

    def _see_gel(self) -> None:
        """`gelgate gel replace`, another process, may have recorded a new gel meanwhile."""
        if self._gel is not None:
            gel = self._store.gel(self._gel.serial, self._clock.time_ns())
            if gel.gel_id != self._gel.gel_id:
                self._replaced(gel)

    # Commands: they arrive on a sink's thread and are done by the loop's

    def _on_trigger(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        NoArguments.of(arguments)

        def triggered() -> Mapping[str, Any]:
            taker = self._known_taker()
            refusal = taker.trigger()
            if refusal is not None:
                raise ValueError(refusal)
            return {"state": taker.tracker.state.value}

        return self._requests.ask(triggered)

    def _on_relearn(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        NoArguments.of(arguments)

        def relearnt() -> Mapping[str, Any]:
            taker = self._known_taker()
            self._relearn()
            return {"state": taker.tracker.state.value}

        return self._requests.ask(relearnt)

    def _on_replace_gel(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        wish = ReplaceGelArguments.of(arguments)

        def replaced() -> Mapping[str, Any]:
            self._known_taker()
            assert self._gel is not None
            gel = self._store.replace_gel(
                self._gel.serial, self._clock.time_ns(), wish.gel_id, wish.limit_presses, wish.note
            )
            self._replaced(gel)
            return {"gel_id": gel.gel_id, "presses": gel.presses, "limit_presses": gel.limit_presses}

        return self._requests.ask(replaced)

    def _known_taker(self) -> PressTaker:
        if self._taker is None:
            raise DeviceNotFound("no frame has arrived from a sensor yet, so it is not known what is meant")
        return self._taker
