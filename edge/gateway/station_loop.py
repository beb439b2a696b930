"""The loop of a running station: frames, calls of other threads, presses to record, and the regular report.

One thread reads the sensor and one per sink publishes. The thread that calls `run` does everything between: contact,
score, verdict, and the one transaction that counts a press and queues its messages. `step` is one turn without waiting,
so a test can drive it in any order; `run` adds the waiting.
"""

import logging
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from edge.acquisition import Acquisition
from edge.config import Config
from edge.core.digital_io import LOOP_S
from edge.core.errors import DeviceNotFound, RecordingEnded, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock
from edge.gateway.inspection_session import InspectionSession
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.opening import check_mode
from edge.gateway.part_selection import PartSelection
from edge.gateway.pictures import Pictures
from edge.gateway.recorder import PressReport, Recorder
from edge.gateway.report import FreeSpace, Report, Summary
from edge.gateway.service_manager import ServiceManager
from edge.gateway.status import StationStatus
from edge.messaging.publisher import Publisher
from edge.press_stage import PressStage
from edge.store.gel_files import GelFiles
from edge.store.press_store import Store

__all__ = ["OnPress", "Parts", "StationLoop"]

log = logging.getLogger(__name__)

# While it waits for a frame the loop wakes this often, to serve calls and detect faults.
WAIT_S: Final = 0.2
# Another thread looks this often whether the loop turns.
WATCH_S: Final = 1.0
# The pause before a store that refuses writes is tried again.
STORE_RETRY_S: Final = 1.0

OnPress = Callable[[PressReport], None]
S = TypeVar("S", bound=PressStage)


@dataclass(frozen=True)
class Parts:
    """The parts of a station, built by `edge.gateway.build` and not yet started. Their builder closes them."""

    config: Config
    stages: Sequence[PressStage]
    """What a press goes through, in this order."""
    selection: PartSelection
    store: Store
    publisher: Publisher
    status: StationStatus
    acquisition: Acquisition
    pictures: Pictures
    free_space: FreeSpace
    calls: LoopCalls[Any]
    """Calls of other threads, with the loop that has these parts."""
    clock: Clock


class StationLoop:
    """The work of a station between reading and publishing. One thread uses it; others use `Parts.calls`.

    is_halted: the store refuses a press or a gel. Frames are still processed: presses wait in memory, and what does not
    fit is counted. session: the sensor and its gel; None before the first frame.
    """

    def __init__(self, parts: Parts, on_press: OnPress = lambda report: None) -> None:
        self.parts = parts
        self.session: InspectionSession | None = None
        self.is_halted = False
        self.report = Report(
            parts.store, parts.publisher, parts.status, parts.acquisition, parts.free_space, parts.clock
        )
        self._refused_ns = 0
        self._is_reload_wanted = False
        self._on_press = on_press
        self._turned_ns = parts.clock.monotonic_ns()
        self._last_stats_ns = parts.clock.monotonic_ns()
        parts.selection.on_change = self._follow_selection

    @property
    def summary(self) -> Summary:
        """The counts of the run so far."""
        return self.report.summary

    @property
    def is_pressed(self) -> bool:
        """True while something presses the gel."""
        return self.session is not None and self.session.has_contact

    def find(self, kind: type[S]) -> S | None:
        """Return the stage of this kind; None where it is not configured."""
        return next((stage for stage in self.parts.stages if isinstance(stage, kind)), None)

    def need_session(self) -> InspectionSession:
        """Return the session. Errors: DeviceNotFound before the first frame."""
        if self.session is None:
            raise DeviceNotFound(
                "no frame has arrived from a sensor yet, so its gel is not known; try again later"
            )
        return self.session

    def run(self, stop: threading.Event, presses: int | None = None) -> Summary:
        """Start every part, and inspect as `turn_until` does; returns the counts of the run."""
        self.parts.publisher.start()
        self.parts.pictures.start()
        for stage in self.parts.stages:
            stage.start()
        self.parts.acquisition.start()
        self.parts.selection.start()
        manager, ended = ServiceManager(self.parts.clock), threading.Event()
        self._turned_ns = self.parts.clock.monotonic_ns()
        threading.Thread(target=self._keep_watching, args=(ended,), name="loop-watch", daemon=True).start()
        manager.ready()
        try:
            self.turn_until(stop, presses, manager.alive)
        finally:
            ended.set()
        manager.stopping()
        return self.summary

    def _keep_watching(self, ended: threading.Event) -> None:
        while not ended.wait(WATCH_S):
            self.watch()

    def watch(self) -> None:
        """Say that the loop hangs, in a detector or on a disk: its last verdict would stand as if it were of now.
        Another thread calls it."""
        silent_ns = self.parts.clock.monotonic_ns() - self._turned_ns
        self.parts.status.set_hanging(silent_ns > LOOP_S * 1e9)

    def reload(self) -> None:
        """Open the bundles again with the next turn. A handler of a signal may call it: no lock is taken."""
        self._is_reload_wanted = True

    def turn_until(
        self, stop: threading.Event, presses: int | None = None, on_turn: Callable[[], None] = lambda: None
    ) -> None:
        """Step until `stop` is set, a recording ends, or that number of presses was recorded.

        on_turn: called after every step. Errors: StoreError when the store still refuses a press at the end;
        BundleMismatch for a sensor of another mode.
        """
        try:
            while not stop.is_set() and (presses is None or self.summary.presses < presses):
                self.step(self.parts.acquisition.next(WAIT_S))
                on_turn()
        except RecordingEnded as end:
            self.summary.has_ended = True
            log.info("%s", end)
            while self.is_halted and not stop.wait(STORE_RETRY_S):
                self.step(None)
                on_turn()
        finally:
            self.parts.calls.close(self)
            self.parts.selection.golden.close()
        self._record()
        self.publish_stats()

    def step(self, frame: CameraFrame | None) -> None:
        """Take one turn, with the next frame if there is one. Without a frame a store that refused is tried again at
        once, with one after STORE_RETRY_S."""
        parts, now_ns = self.parts, self.parts.clock.monotonic_ns()
        self._turned_ns = now_ns
        parts.status.set_hanging(False)
        # A frame that is made on demand was not waiting: its time is that of a recording.
        is_live = frame is not None and not frame.is_on_demand
        parts.calls.serve(self, frame.timestamp_ns if frame is not None and is_live else math.inf)
        if self._is_reload_wanted:
            self._is_reload_wanted = False
            parts.selection.reload()
        if frame is not None:
            for stage in parts.stages:
                stage.take(frame)
        is_trying = frame is None or not self.is_halted or now_ns - self._refused_ns > STORE_RETRY_S * 1e9
        try:
            if frame is not None and (self.session is not None or is_trying):
                session = self.session or self._start_session()
                self.report.count_frame(frame, has_contact=session.has_contact)
                session.feed(frame)
            if is_trying:
                parts.selection.step(is_pressed=self.is_pressed)
                mounted = self.session.mounted if self.session else None
                for stage in parts.stages:
                    stage.turn(mounted)
                self._record()
                self.is_halted = False
        except StoreError as error:
            self.is_halted = True
            self._refused_ns = now_ns
            self.report.note_store_fault(error)
        if self.is_halted and self.session is not None:
            parts.store.note_uncounted(self.session.gel.serial, self.session.unrecorded)
        for stage in parts.stages:
            stage.show(parts.status.view())  # with what the stages before it have just said of the contact
        if parts.clock.monotonic_ns() - self._last_stats_ns > parts.config.station.stats_s * 1e9:
            self.publish_stats()

    def publish_stats(self) -> None:
        """Publish the counts so far, check whether another process replaced the gel, and retry refused pictures."""
        self._last_stats_ns = self.parts.clock.monotonic_ns()
        self.parts.pictures.retry()
        self.report.publish(self.session, is_halted=self.is_halted)

    def _follow_selection(self) -> None:
        """Another bundle is in use, or others may be selected."""
        selection = self.parts.selection
        if self.session is not None and self.session.inspector is not selection.inspector:
            self.session.use(selection.inspector)
        self._say_info()

    def _say_info(self) -> None:
        """Say what inspects; before the first frame the sensor is not known, and nothing is said."""
        if (identity := self.parts.acquisition.status.identity) is not None:
            selection = self.parts.selection
            names = list(map(str, selection.bundles.bundles))
            is_drawn_on = self.parts.config.features["drawn_regions"]
            self.parts.status.info(selection.inspector.bundle, identity, names, is_drawn_on=is_drawn_on)

    def _start_session(self) -> InspectionSession:
        """The first frame: now the sensor is known, and with it the gel. Errors: StoreError."""
        parts, config = self.parts, self.parts.config
        identity = parts.acquisition.status.identity
        if identity is None:
            raise DeviceNotFound("a frame arrived from a sensor without an identity")
        check_mode(parts.selection.inspector.bundle, identity)
        gel = parts.store.gel(identity.serial, parts.clock.time_ns())
        parts.status.counts(parts.store.findings())
        parts.status.set_fault("store", None)
        self._say_info()
        recorder = Recorder(
            parts.store,
            identity.serial,
            config.station.place,
            parts.clock,
            parts.pictures.add,
            parts.stages,
            heatmap=config.station.heatmap,
            keeps_heatmap=config.keeps_heatmap,
        )
        self.session = InspectionSession(
            gel,
            parts.selection.inspector,
            config.contact.settings(is_external=config.inspection.trigger == "command"),
            GelFiles(config.store.path.with_suffix(".references")),
            recorder,
            parts.status,
            parts.clock,
            parts.stages,
        )
        return self.session

    def _record(self) -> None:
        """Write the presses that wait. Errors: StoreError; no press is lost."""
        awaited = [stage for stage in self.parts.stages if stage.is_awaited]
        for report in self.session.record() if self.session else ():
            for stage in awaited:  # before the publisher's threads wake
                stage.record(report.press, report.gel)
            self.parts.status.set_fault("store", None)
            self.parts.publisher.wake()
            self.summary.add(report)
            self._on_press(report)
            for stage in self.parts.stages:
                if not stage.is_awaited:
                    stage.record(report.press, report.gel)
