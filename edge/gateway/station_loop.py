"""The loop of a running station: frames, calls of other threads, presses to record, and the regular report.

`step` is one turn without waiting, so a test can drive it in any order; `run` adds the waiting.
"""

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

from edge.core.errors import BundleMismatch, DeviceNotFound, RecordingEnded, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import QualitySettings
from edge.core.overview.rules import OverviewView
from edge.core.part_position import PartPosition
from edge.core.ports import DeviceIdentity
from edge.core.suggest import suggestion
from edge.gateway.clock_guard import ClockGuard
from edge.gateway.inspection_session import InspectionSession
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.overload import OverloadRule
from edge.gateway.part_selection import PartSelection
from edge.gateway.press_stage import Stages
from edge.gateway.recorder import PressReport, Recorder
from edge.gateway.station_parts import Parts
from edge.gateway.summary import Summary
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.sink_worker import SinkCounters
from edge.store.acts import Act

__all__ = ["OnPress", "StationLoop"]

log = logging.getLogger(__name__)

# While it waits for a frame the loop wakes this often, to serve calls and detect faults.
WAIT_S: Final = 0.2
# A frame older than this when it is processed cannot be judged any more.
LATE_NS: Final = round(QualitySettings().max_age_s * 1e9)
# The pause before a store that refuses writes is tried again.
STORE_RETRY_S: Final = 1.0

OnPress = Callable[[PressReport], None]


class StationLoop:
    """The work of a station between reading and publishing. One thread uses it; others use `Parts.calls`.

    is_halted: the store refuses a press or a gel. Frames are still processed: presses wait in memory, and what does not
    fit is counted.
    """

    def __init__(self, parts: Parts, on_press: OnPress = lambda report: None) -> None:
        self.summary = Summary()
        self.is_halted = False
        self._refused_ns = 0
        self._parts = parts
        self._stages = Stages(parts.stages(parts, self._select_by_code))
        self._on_press = on_press
        self._session: InspectionSession | None = None
        self._overload = OverloadRule()
        self._clock_guard = ClockGuard(parts.clock)
        self._dropped_before = 0
        self._was_held_up = False
        self._unrecorded_act: Act | None = None
        self._last_stats_ns = parts.clock.monotonic_ns()

    @property
    def parts(self) -> Parts:
        """What it works with."""
        return self._parts

    @property
    def calls(self) -> "LoopCalls[StationLoop]":
        """The calls of other threads."""
        return self._parts.calls

    @property
    def session(self) -> InspectionSession:
        """The sensor and its gel. Errors: DeviceNotFound before the first frame."""
        if self._session is None:
            raise DeviceNotFound(
                "no frame has arrived from a sensor yet, so its gel is not known; try again later"
            )
        return self._session

    def run(
        self, stop: threading.Event, presses: int | None = None, on_turn: Callable[[], None] = lambda: None
    ) -> None:
        """Step until `stop` is set, a recording ends, or that number of presses was recorded.

        on_turn: called after every step. Errors: StoreError when the store still refuses a press at the end;
        BundleMismatch for a sensor of another mode.
        """
        try:
            while not stop.is_set() and (presses is None or self.summary.presses < presses):
                self.step(self._parts.acquisition.next(WAIT_S))
                on_turn()
        except RecordingEnded as end:
            self.summary.has_ended = True
            log.info("%s", end)
            while self.is_halted and not stop.wait(STORE_RETRY_S):
                self.step(None)
                on_turn()
        finally:
            self._parts.calls.close(self)
            self.selection.close()
        self._record()
        self.publish_stats()

    def step(self, frame: CameraFrame | None) -> None:
        """One turn, with the next frame if there is one. Without a frame a store that refused is tried again at once,
        with one after STORE_RETRY_S."""
        now_ns = self._parts.clock.monotonic_ns()
        self._parts.calls.serve(self)
        if frame is not None:
            self._parts.snapshots.see(frame)
        is_trying = frame is None or not self.is_halted or now_ns - self._refused_ns > STORE_RETRY_S * 1e9
        try:
            if frame is not None and (self._session is not None or is_trying):
                self._look_at(frame)
            if is_trying:
                self._follow_selection()
                mounted = self._session.mounted if self._session else None
                self._stages.turn(mounted)
                self._record()
                self._note_act()
                self.is_halted = False
        except StoreError as error:
            self.is_halted = True
            self._refused_ns = now_ns
            self._set_store_fault(error)
        if self.is_halted and self._session is not None:
            self._parts.store.note_uncounted(self._session.gel.serial, self._session.unrecorded)
        self._parts.io.turn(self._parts.status.view())
        if self._parts.clock.monotonic_ns() - self._last_stats_ns > self._parts.stats_s * 1e9:
            self.publish_stats()

    def replace_gel(self, gel_id: str | None, limit_presses: int | None, note: str) -> None:
        """Record that a new gel is mounted, and learn its picture. Errors: DeviceNotFound, StoreError."""
        serial, time_ns = self.session.gel.serial, self._parts.clock.time_ns()
        self.session.see_gel(self._parts.store.replace_gel(serial, time_ns, gel_id, limit_presses, note))

    @property
    def has_session(self) -> bool:
        """Whether a frame has arrived, so that sensor and gel are known."""
        return self._session is not None

    @property
    def selection(self) -> PartSelection:
        """The bundles, and the part that is inspected."""
        return self._parts.selection

    def select_part(self, part: str, position: str | None = None) -> None:
        """Inspect this from the next press on. Errors: ValueError, which names the known; StoreError."""
        self._select(self.selection.bundles.find(part, position))

    def select_named(self, name: str) -> None:
        """The same by name: for a code reader, with the text that it has read. Errors as `select_part`."""
        self._select(self.selection.bundles.named(name))

    def trigger(self) -> None:
        """A pedal or button asks for a verdict. No one waits for an answer, so a refusal is in the log."""
        try:
            refusal = self.session.trigger()
        except DeviceNotFound as error:
            refusal = str(error)
        if refusal is not None:
            log.warning("the trigger gave no verdict: %s", refusal)

    def acknowledge(self) -> None:
        """A person has seen the last verdict, and the pulses that were not given."""
        self._parts.io.acknowledge()

    @property
    def alarms(self) -> list[str]:
        """Those that are raised, in order."""
        return sorted(self._parts.status.view().alarms)

    def acknowledge_alarm(self, alarm: str) -> None:
        """A person has seen an alarm that does not end by itself. Errors: ValueError for every other one."""
        if alarm not in ALARMS:
            raise ValueError(f"no alarm is named '{alarm}'; {suggestion(alarm, sorted(ALARMS))}")
        staying = {
            "pulse": self._parts.io.acknowledge_pulses,
            "outbox_full": self._parts.status.acknowledge_dropped,
            "counts": self._parts.store.findings.clear,
        }
        if alarm not in staying:
            raise ValueError(
                f"the alarm '{alarm}' ends by itself when its reason is over; see docs/operations.md"
            )
        if alarm not in self.alarms:
            raise ValueError(f"the alarm '{alarm}' is not raised; raised: {', '.join(self.alarms) or 'none'}")
        staying[alarm]()
        self._parts.status.clear(alarm)

    def snapshot(self, before_s: float, after_s: float) -> Path:
        """Write the frames around now as a recording; returns its folder. Errors: ValueError when that cannot be."""
        low = self._parts.free_space.check()
        if low is not None:
            raise ValueError(f"no snapshot is written: {low}")
        return self._parts.snapshots.request(before_s, after_s)

    def publish_stats(self) -> None:
        """Publish the counts so far, and check whether another process replaced the gel."""
        parts = self._parts
        self._last_stats_ns = parts.clock.monotonic_ns()
        self.summary.see(parts.acquisition.status, self._session.corrupt if self._session else 0)
        self._say_load()
        parts.status.disk(parts.free_space.check())
        parts.status.archive(parts.black_box.fault)
        try:
            self._note_clock_step()
            if self._session is not None:
                self._session.see_gel(parts.store.gel(self._session.gel.serial, parts.clock.time_ns()))
            outbox, head = parts.publisher.outbox_status(), str(parts.store.ledger_head())
        except StoreError as error:
            self._set_store_fault(error)
            return
        if not self.is_halted:
            parts.status.clear_fault("store")
        counters = parts.publisher.counters()
        parts.status.stats(
            self.summary,
            parts.acquisition.status,
            outbox,
            {name: _word(one) for name, one in counters.items()},
            parts.free_space.bytes,
            self._session.gel if self._session else None,
            head,
        )
        parts.status.refused(outbox.refused, [c.last_refusal for c in counters.values() if c.last_refusal])
        parts.status.receivers([f"{name}: {fault}" for name, c in counters.items() for fault in c.faults])
        parts.status.counts(parts.store.findings)

    def _note_act(self) -> None:
        """Record a snapshot that was written, or a time without sight, in the table of acts. Errors: StoreError."""
        identity = self._parts.acquisition.status.identity
        self._unrecorded_act = self._unrecorded_act or self._parts.snapshots.take(identity)
        self._unrecorded_act = self._unrecorded_act or self._parts.sensing.take_act()
        if self._unrecorded_act is not None:
            self._parts.store.begin_act(self._unrecorded_act, within_s=0)
            self._unrecorded_act = None

    def _note_clock_step(self) -> None:
        """Into the log and the table of acts. Errors: StoreError."""
        seconds = self._clock_guard.step()
        if seconds is None:
            return
        log.warning("the clock of this machine was set by %+.0f s", seconds)
        now_ns, step = self._parts.clock.time_ns(), {"seconds": seconds}
        self._parts.store.begin_act(
            Act(now_ns, "the gateway", "clock_step", arguments=step, outcome="done"), within_s=0
        )

    def _select(self, part: PartPosition, why: Act | None = None, *, is_beginning: bool = False) -> None:
        """What cannot be recorded is not done later either. Errors: StoreError."""
        before = self.selection.wanted
        self.selection.select(part, why)
        try:
            self._follow_selection(is_beginning=is_beginning)
        except StoreError:
            self.selection.select(before)
            raise

    def _select_by_code(self, part: PartPosition, view: OverviewView) -> None:
        """The overview camera has read the code of this part, and its press begins. Errors: StoreError."""
        why = Act(
            self._parts.clock.time_ns(),
            "the overview camera",
            "select_part",
            arguments={"codes": [code.text for code in view.codes]},
            outcome="done",
            before={"part": self.selection.part.part, "position": self.selection.part.position},
            after={"part": part.part, "position": part.position},
        )
        self._select(part, why, is_beginning=True)

    def _follow_selection(self, *, is_beginning: bool = False) -> None:
        """Between two presses another bundle may take over; a press that is just beginning can still have it. Errors:
        StoreError."""
        session = self._session
        is_pressed = session is not None and session.has_contact and not is_beginning
        before = self.selection.bundles
        has_changed = self.selection.step(is_pressed=is_pressed)
        if has_changed and session is not None:
            session.use(self.selection.inspector)
        if has_changed or self.selection.bundles is not before:
            self._say_info()

    def _say_info(self) -> None:
        """Before the first frame the sensor is not known, and nothing is said."""
        if (identity := self._parts.acquisition.status.identity) is not None:
            parts = list(map(str, self.selection.bundles.bundles))
            self._parts.status.info(self.selection.inspector.bundle, identity, parts)

    def _look_at(self, frame: CameraFrame) -> None:
        session = self._session or self._start_session()
        self._count_lost(frame, session)
        session.feed(frame)

    def _start_session(self) -> InspectionSession:
        """The first frame: now the sensor is known, and with it the gel. Errors: StoreError."""
        parts = self._parts
        identity = parts.acquisition.status.identity
        if identity is None:
            raise DeviceNotFound("a frame arrived from a sensor without an identity")
        self._check_mode(identity)
        gel = parts.store.gel(identity.serial, parts.clock.time_ns())
        parts.status.counts(parts.store.findings)
        parts.status.clear_fault("store")
        inspector = self.selection.inspector
        recorder = Recorder(
            parts.store, inspector, identity.serial, parts.place, parts.clock, parts.black_box
        )
        self._say_info()
        self._session = InspectionSession(
            gel,
            inspector,
            parts.contact,
            parts.references,
            recorder,
            parts.status,
            parts.clock,
            self._stages,
        )
        return self._session

    def _check_mode(self, identity: DeviceIdentity) -> None:
        bundle = self.selection.inspector.bundle
        (w, h), (found_w, found_h) = bundle.profile.native, identity.mode
        if identity.mode != bundle.profile.native:
            raise BundleMismatch(
                f"bundle {bundle.where} was made from {w}x{h} frames (profile {bundle.profile.name}), sensor "
                f"{identity.serial} sends {found_w}x{found_h}; use a bundle made for this sensor's mode"
            )

    def _count_lost(self, frame: CameraFrame, session: InspectionSession) -> None:
        """Count the frames for which this machine was too slow."""
        dropped, now_ns = self._parts.acquisition.status.dropped, self._parts.clock.monotonic_ns()
        self.summary.add_lost(
            is_late=not frame.is_on_demand and now_ns - frame.timestamp_ns > LATE_NS,
            was_interrupted=dropped > self._dropped_before and session.has_contact,
        )
        self._dropped_before = dropped

    def _record(self) -> None:
        """Write the presses that wait. Errors: StoreError; no press is lost."""
        for report in self._session.record() if self._session else ():
            self._parts.status.clear_fault("store")
            self._parts.publisher.wake()
            self.summary.add(report)
            self._on_press(report)
            self._stages.record(report)

    def _set_store_fault(self, error: StoreError) -> None:
        self._was_held_up = True
        if self._parts.status.set_fault("store", str(error)):
            log.error("%s", error)

    def _say_load(self) -> None:
        """Frames lost because the store refuses writes have their own alarm."""
        if self._was_held_up:
            self._overload.skip(self.summary.frames)
            self._was_held_up = False
        self._parts.status.overload(self._overload.step(self.summary.frames))


def _word(counters: SinkCounters) -> str:
    """A receiver's state in `stats`."""
    level = f", MQTT {counters.level}" if counters.level else ""
    return ("up" if counters.is_up else counters.last_error or "not yet tried") + level
