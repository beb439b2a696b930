"""One sensor with its gel: from its frames to judged presses, and from the free gel to its wear.

It exists from the first frame on: before that the sensor, and so the gel of a press, is not known.
"""

import logging
from collections import deque
from collections.abc import Iterator
from typing import Final

from edge.core.contact.events import (
    Event,
    ReferenceCorrected,
    ReferenceDoubted,
    ReferenceReady,
    ReferenceRefreshed,
    StartedTouched,
)
from edge.core.contact.light import foreign_start
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.settings import ContactSettings
from edge.core.contact.wear import wear
from edge.core.imaging.frames import CameraFrame
from edge.core.part_position import PartPosition
from edge.core.ports import Clock
from edge.core.press import Press
from edge.gateway.inspector import Inspector
from edge.gateway.press_pipeline import PressPipeline
from edge.gateway.press_stage import Mounted, PressStage
from edge.gateway.recorder import JudgedPress, PressReport, Recorder
from edge.gateway.status import StationStatus
from edge.logs import about_press
from edge.model.gel_facts import read_origin
from edge.store.gel_ledger import GelRecord
from edge.store.reference_files import ReferenceFolder

__all__ = ["InspectionSession"]

log = logging.getLogger(__name__)

# The station waits for this before it inspects.
FREE_GEL: Final = "the free gel, to learn its picture"
# Presses that wait while the database refuses writes, each with a picture of some 60 kB; more are only counted.
MOST_WAITING: Final = 256
# The alarm while the picture of the free gel may be wrong.
DOUBTED: Final = (
    "the picture of the free gel was most likely learnt while something pressed; nothing is scored until the free gel "
    "is seen at rest: lift the part for a second"
)


class InspectionSession:
    """Presses of one sensor. Used by the loop alone.

    gel: the mounted gel, with its count. Judged presses wait here until they are recorded, in order. stages: what each
    press goes through.
    """

    def __init__(
        self,
        gel: GelRecord,
        inspector: Inspector,
        settings: ContactSettings,
        references: ReferenceFolder,
        recorder: Recorder,
        status: StationStatus,
        clock: Clock,
        stages: PressStage,
    ) -> None:
        self.gel = gel
        self._stages = stages
        self._references = references
        self._recorder = recorder
        self._status = status
        self._unrecorded: deque[JudgedPress] = deque()
        self._uncounted = 0  # presses for which there was no room to wait
        stored = references.load(gel.serial, gel.gel_id, "last")
        self._at_fit = inspector.bundle.free_reference
        detector = PressDetector(inspector.bundle.profile, settings, stored, self._at_fit)
        self._inspector = inspector
        stages.use(inspector)
        stages.mount(gel)
        self._pipeline = PressPipeline(detector, inspector, clock, stages, self._see)
        status.gel(gel)
        status.set_waiting_for(FREE_GEL)

    @property
    def has_contact(self) -> bool:
        """Whether something presses the gel."""
        return self._pipeline.tracker.has_contact

    @property
    def mounted(self) -> Mounted:
        """What a press would be made with now."""
        manifest = self._inspector.bundle.manifest
        part = PartPosition(manifest.part, manifest.position)
        digest = self._inspector.bundle.digest
        return Mounted(
            self.gel.serial, self.gel.gel_id, part, digest, self.has_contact, read_origin(manifest)
        )

    @property
    def contact_state(self) -> str:
        """The state of the contact table, as in a command's response."""
        return self._pipeline.tracker.state.value

    @property
    def corrupt(self) -> int:
        """Frames that arrived and could not be decoded."""
        return self._pipeline.detector.corrupt

    def feed(self, frame: CameraFrame) -> None:
        """One camera frame; a press that it decides waits to be recorded."""
        self._add(self._pipeline.feed(frame))

    def record(self) -> Iterator[PressReport]:
        """Write the waiting presses, oldest first. Errors: StoreError; that press and the later ones keep waiting."""
        while self._unrecorded:
            with about_press(self._unrecorded[0].press.press_id):
                report = self._recorder.record(self._unrecorded[0])
            self._unrecorded.popleft()
            self.see_gel(report.gel)
            self._status.gel_wear(report.gel)
            yield report

        if self._uncounted:
            self.see_gel(self._recorder.count(self._uncounted))
            self._uncounted = 0

    @property
    def unrecorded(self) -> int:
        """Presses that the database does not have yet."""
        return len(self._unrecorded) + self._uncounted

    def trigger(self) -> str | None:
        """Request a verdict now; returns why there will be none, or None."""
        return self._pipeline.trigger()

    def use(self, inspector: Inspector) -> None:
        """Judge with another bundle from the next press on. Only while no press waits for its verdict, or when one has
        just begun."""
        self._inspector = inspector
        self._pipeline.use(inspector)
        self._stages.use(inspector)
        self._recorder.use(inspector)
        self._at_fit = inspector.bundle.free_reference

    def relearn(self) -> None:
        """Learn the free gel again."""
        self._status.set_waiting_for(FREE_GEL)
        self._add(self._pipeline.relearn())

    def see_gel(self, gel: GelRecord) -> None:
        """The gel that is mounted by the ledger; for another gel than before, everything learnt is discarded."""
        is_other = gel.gel_id != self.gel.gel_id
        self.gel = gel
        if is_other:
            self._status.gel(gel)
            self._recorder.wear_index = None
            self._stages.mount(gel)
            self.relearn()

    def _add(self, presses: list[Press]) -> None:
        for press in presses:
            if len(self._unrecorded) < MOST_WAITING:
                self._unrecorded.append(self._recorder.prepare(press))
            else:
                self._uncounted += 1

    def _see(self, event: Event) -> None:
        log.debug("%s", event)
        match event:
            case StartedTouched():
                log.warning("something presses the gel at the start; nothing is inspected until it is free")
                self._status.set_waiting_for(f"{FREE_GEL}; something presses it")
            case ReferenceDoubted():
                log.warning("%s", DOUBTED)
                self._status.set_fault("free_gel", DOUBTED)
            case ReferenceCorrected():
                self._references.forget(self.gel.serial, self.gel.gel_id)
            case ReferenceReady():
                self._status.clear_fault("free_gel")
                self._status.set_waiting_for(None)
                self._compare_light()
                self._measure_wear()
            case ReferenceRefreshed():
                self._measure_wear()

    def _compare_light(self) -> None:
        """Once the free gel is learnt, a light different from that of the fit is reported."""
        learnt = self._pipeline.tracker.reference
        difference = foreign_start(learnt, self._at_fit) if learnt and self._at_fit else None
        if difference is not None:
            log.warning("%s", difference)

    def _measure_wear(self) -> None:
        """The gel is free: keep its picture, and compare it with the first of this gel."""
        reference = self._pipeline.tracker.reference
        if reference is None:
            return
        serial, gel_id = self.gel.serial, self.gel.gel_id
        self._references.save(serial, gel_id, reference)
        first = self._references.load(serial, gel_id, "first")
        self._stages.learn(None if first is None else first.view)
        if first is not None and first.view.shape == reference.view.shape:
            self._recorder.wear_index = wear(first.view, reference.view).index
