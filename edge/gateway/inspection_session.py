"""One sensor with its gel: from frames to judged presses that wait to be recorded, from the free gel to its wear.

It exists from the first frame on: before that the sensor, and so the gel of a press, is not known.
"""

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from edge.core.contact.events import (
    Event,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceCorrected,
    ReferenceDoubted,
    ReferenceReady,
    ReferenceRefreshed,
    StartedTouched,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.reference import View
from edge.core.contact.settings import ContactSettings
from edge.core.contact.wear import foreign_start, wear
from edge.core.errors import StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Reason, Rejection
from edge.core.part_position import PartPosition
from edge.core.ports import Clock
from edge.core.press import JudgedFrame, Press, PressLabel
from edge.core.sentence import Sentence
from edge.gateway.recorder import PressReport, Recorder, WaitingPress
from edge.gateway.status import StationStatus
from edge.logs import about_press
from edge.model.inspector import Inspector
from edge.press_stage import Mounted, PressStage
from edge.store.gel_files import GelFiles
from edge.store.gel_ledger import GelRecord
from edge.store.ulid import new_ulid

__all__ = ["InspectionSession"]

log = logging.getLogger(__name__)

# The station waits for this before it inspects.
FREE_GEL: Final = Sentence("two seconds of the free gel, to learn its picture")
# Presses that wait while the database refuses writes, each with a picture of some 60 kB; more are only counted.
MOST_WAITING: Final = 256
# The alarm while the picture of the free gel may be wrong.
DOUBTED: Final = Sentence(
    "the picture of the free gel was most likely learnt while something pressed; nothing is scored until the free gel "
    "is seen at rest: lift the part for a second"
)


class InspectionSession:
    """Presses of one sensor: contact finds one, the stages admit it, the inspector scores its one frame, the stages
    judge it. Used by the loop alone.

    gel: the mounted gel, with its count. Judged presses wait here until they are recorded, in order.
    """

    def __init__(
        self,
        gel: GelRecord,
        inspector: Inspector,
        settings: ContactSettings,
        references: GelFiles,
        recorder: Recorder,
        status: StationStatus,
        clock: Clock,
        stages: Sequence[PressStage],
    ) -> None:
        self.gel, self.inspector = gel, inspector
        self._references, self._recorder, self._status, self._clock = references, recorder, status, clock
        self._stages = stages
        self._label: PressLabel | None = None
        self._waiting: deque[WaitingPress] = deque()
        self._ahead_ns = 0  # the time of the frame at which a press was last scored ahead
        self._uncounted = 0  # presses for which there was no room to wait
        self._is_kept = False  # the picture of the free gel, as one that is known to be so
        stored, bundle = references.load_picture(gel.serial, gel.gel_id, "last"), inspector.bundle
        self._detector = PressDetector(bundle.profile, settings, stored, bundle.free_reference)
        for stage in stages:
            stage.use(inspector)
            stage.mount(gel)
        status.gel(gel)
        status.set_waiting_for(FREE_GEL)

    @property
    def has_contact(self) -> bool:
        """True while something presses the gel."""
        return self._detector.tracker.has_contact

    @property
    def mounted(self) -> Mounted:
        """The sensor, gel, part and bundle that a press would be made with now."""
        bundle = self.inspector.bundle
        part = PartPosition(bundle.manifest.part, bundle.manifest.position)
        return Mounted(self.gel.serial, self.gel.gel_id, part, bundle.digest, self.has_contact)

    @property
    def contact_state(self) -> str:
        """The state of the contact table, as in a command's response."""
        return self._detector.tracker.state.value

    @property
    def corrupt(self) -> int:
        """Frames that arrived and could not be decoded."""
        return self._detector.corrupt

    @property
    def unrecorded(self) -> int:
        """Presses that the database does not have yet."""
        return len(self._waiting) + self._uncounted

    def feed(self, frame: CameraFrame) -> None:
        """Look at one camera frame; a press that it decides waits to be recorded."""
        look = self._detector.feed(frame)
        presses = self._judge_all(look.events)
        for stage in self._stages:
            stage.look(look)
        self._add(presses)
        self._score_ahead(frame)

    def record(self) -> Iterator[PressReport]:
        """Write the waiting presses, oldest first. Errors: StoreError; that press and the later ones keep waiting."""
        while self._waiting:
            with about_press(self._waiting[0].row.press_id):
                try:
                    report = self._recorder.record(self._waiting[0])
                except StoreError:
                    self._waiting[0] = self._waiting[0].delay()
                    raise
            recorded = self._waiting.popleft()
            self.see_gel(report.gel)
            self._status.gel_wear(report.gel)
            try:
                yield report
            finally:  # also where a stage cannot take the press
                self._recorder.follow(recorded, report.gel, self.unrecorded)
        if self._uncounted:
            self.see_gel(self._recorder.count(self._uncounted))
            self._uncounted = 0

    def trigger(self) -> str | None:
        """Request a verdict now; returns why there will be none, or None."""
        refusal = None
        for event in self._detector.tracker.trigger():
            self._see(event)
            match event:
                case TriggerWithoutContact():
                    refusal = f"nothing presses the gel ({event.state.value}); trigger while the part is held"
                case TriggerRepeated():
                    refusal = f"this press has its verdict ({event.state.value}); lift and press again"
        return refusal

    def use(self, inspector: Inspector) -> None:
        """Judge with another bundle from the next press on. Only while no press waits for its verdict, or when one has
        just begun."""
        self.inspector.forget_ahead()
        self.inspector = inspector
        self._follow_light()
        if self._detector.newest is not None and not self.has_contact:
            inspector.warm_up(self._detector.newest)
        for stage in self._stages:
            stage.use(inspector)

    def relearn(self) -> None:
        """Learn the free gel again."""
        self._status.set_waiting_for(FREE_GEL)
        for stage in self._stages:
            stage.relearn()
        self._add(self._judge_all(self._detector.tracker.relearn()))

    def see_gel(self, gel: GelRecord) -> None:
        """Take the gel that is mounted by the ledger; for another gel than before, everything learnt is discarded."""
        is_other = gel.gel_id != self.gel.gel_id
        self.gel = gel
        if is_other:
            self._status.gel(gel)
            self._recorder.wear_index = None
            for stage in self._stages:
                stage.mount(gel)
            self.relearn()

    def _judge_all(self, events: Iterable[Event]) -> list[Press]:
        """Return the presses that these events complete (at most one)."""
        presses = []
        for event in events:
            self._see(event)
            match event:
                case PressBegan():
                    self._follow_light(is_press=True)
                    label = None
                    for stage in self._stages:
                        label = stage.begin(label)
                    self._label = label
                case PressSettled():
                    presses.append(self._judge(Press(), event))
                case PressNotSettled():
                    text = Sentence(
                        f"the press gave no still frame: {event.reason.value}; press longer and without sliding"
                    )
                    presses.append(self._judge(Press().reject(Rejection(Reason.NOT_SETTLED, text)), None))
        return presses

    def _judge(self, press: Press, settled: PressSettled | None) -> Press:
        """Admit it, score it unless that decided it, and let the stages judge it; the next press is a part's."""
        inspector, time_ns = self.inspector, self._clock.time_ns()
        digest = inspector.bundle.digest
        press = replace(
            press, label=self._label, press_id=new_ulid(time_ns), time_ns=time_ns, bundle_id=digest
        )
        self._label = None
        for stage in self._stages:
            press = stage.admit(press)
        if press.is_decided:
            settled = None
        started_ns = self._clock.monotonic_ns()
        if settled is not None:
            press = self._score(press, settled, started_ns)
        for stage in self._stages:
            press = stage.judge(press, settled, inspector)
        if settled is None:
            return press
        total_ms = (self._clock.monotonic_ns() - started_ns) / 1e6
        return replace(press, latency_ms={**press.latency_ms, "total": total_ms})

    def _score_ahead(self, newest: CameraFrame) -> None:
        """Score the frame that a press is most likely judged by, so that its score is ready when it rests; at most half
        of the time. Not where a score takes longer than half of `settle_s`, nor while frames wait as long: they would
        be dropped before the press rests."""
        took_s, half_s = self.inspector.took_s, self._detector.tracker.settings.settle_s / 2
        waited_ns = 0 if newest.is_on_demand else self._clock.monotonic_ns() - newest.timestamp_ns
        is_slow = max(took_s, waited_ns / 1e9) > half_s
        if is_slow or newest.timestamp_ns - self._ahead_ns < 2 * took_s * 1e9:
            return
        probable = self._detector.probable
        examined = None if probable is None else self.inspector.examine_ahead(*probable)
        if probable is not None and examined is not None:
            self._ahead_ns = newest.timestamp_ns
            for stage in self._stages:
                stage.expect(probable[0], examined)

    def _score(self, press: Press, settled: PressSettled, started_ns: int) -> Press:
        frame, findings = settled.frame, settled.findings
        if frame is None or findings is None:
            return replace(press, error=f"frame {settled.sequence}, chosen for this press, was not kept")
        # A peak may be seconds old when the press is decided: it counts as the oldest frame of a rest would.
        settle_ns = round(self._detector.tracker.settings.settle_s * 1e9)
        came_ns = max(frame.timestamp_ns, settled.timestamp_ns - settle_ns)
        scored = self.inspector.inspect(frame, settled.touch, press, came_ns)
        return replace(
            scored,
            # A frame that was made on demand has its recorded time.
            judged_ns=started_ns if frame.is_on_demand else came_ns,
            judged=JudgedFrame(frame, settled.touch, findings.free),
            is_at_rest=settled.is_held,
        )

    def _add(self, presses: list[Press]) -> None:
        for press in presses:
            if len(self._waiting) < MOST_WAITING:
                waiting = self._recorder.prepare(press, self.inspector)
                is_refused = bool(self._waiting)  # by the store, perhaps for long
                self._waiting.append(waiting.draw_now().delay() if is_refused else waiting)
            else:
                self._uncounted += 1

    def _see(self, event: Event) -> None:
        log.debug("%s", event)
        match event:
            case StartedTouched():
                log.warning("something presses the gel at the start; nothing is inspected until it is free")
                self._status.set_waiting_for(Sentence(f"{FREE_GEL}; something presses it"))
            case ReferenceDoubted():
                log.warning("%s", DOUBTED)
                self._status.set_fault("free_gel", DOUBTED)
            case ReferenceCorrected():
                self._references.forget(self.gel.serial, self.gel.gel_id, "first", "last")
            case ReferenceReady():
                if self._detector.newest is not None:
                    self.inspector.warm_up(self._detector.newest)
                self._status.set_fault("free_gel", None)
                self._status.set_waiting_for(None)
                self._compare_light()
                self._follow_light()
                self._measure_wear()
            case ReferenceRefreshed():
                self._follow_light()
                self._measure_wear()
            case PressEnded():
                if self._detector.tracker.is_confirmed and not self._is_kept:
                    self._keep_picture()
        for stage in self._stages:
            stage.see(event)

    def _compare_light(self) -> None:
        """Once the free gel is learnt, a light different from that of the fit is reported."""
        learnt, at_fit = self._detector.tracker.reference, self.inspector.bundle.free_reference
        difference = foreign_start(learnt, at_fit) if learnt and at_fit else None
        if difference is not None:
            log.warning("%s", difference)

    def _follow_light(self, *, is_press: bool = False) -> None:
        """Score presses under the light of the fit, as the free gel shows the way. is_press: one begins; what was
        learnt of the free gel may be hours old where no pause is long, so the view just before it counts."""
        before, tracker = self.inspector.light, self._detector.tracker
        if not is_press:
            free = None if tracker.reference is None else tracker.reference.view
            self.inspector.new_gel = self._load_new_gel(free)
            self.inspector.follow_light(free)
        self.inspector.follow_light(tracker.newest_free, is_doubtful=True)
        light = self.inspector.light
        if (light is None) != (before is None):
            log.info(
                "%s", "the light is that of the fit" if light is None else f"the light is followed: {light}"
            )

    def _load_new_gel(self, free: View | None) -> View | None:
        """Return the first picture of the mounted gel, by default this one of now; None for the first gel."""
        serial, gel_id = self.gel.serial, self.gel.gel_id
        if not self._references.has_others(serial, gel_id):
            return None
        first = self._references.load_picture(serial, gel_id, "first")
        return free if first is None else first.view

    def _keep_picture(self) -> None:
        """Keep the picture of the free gel; with one that may be of a pressed gel the next start compares nothing."""
        tracker = self._detector.tracker
        if tracker.reference is not None:
            self._is_kept = tracker.is_confirmed
            self._references.save_picture(
                self.gel.serial, self.gel.gel_id, tracker.reference, is_confirmed=self._is_kept
            )

    def _measure_wear(self) -> None:
        """The gel is free: keep its picture, and compare it with the first of this gel."""
        reference = self._detector.tracker.reference
        if reference is None:
            return
        serial, gel_id = self.gel.serial, self.gel.gel_id
        self._keep_picture()
        first = self._references.load_picture(serial, gel_id, "first")
        for stage in self._stages:
            stage.learn(None if first is None else first.view)
        if first is not None and first.view.shape == reference.view.shape:
            self._recorder.wear_index = wear(first.view, reference.view).index
