"""From frames to judged presses: contact finds the press, the inspector judges its one frame."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

from edge.core.contact.events import (
    Event,
    PressBegan,
    PressNotSettled,
    PressSettled,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.tracker import ContactTracker
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Reason, Rejection
from edge.core.ports import Clock
from edge.core.press import JudgedFrame, Press
from edge.core.press_label import PressLabel, ReferenceLabel
from edge.core.reference_press.measures import Imprint
from edge.core.verdict import Verdict
from edge.gateway.admission import Admission
from edge.gateway.inspector import Inspector
from edge.gateway.press_labels import PressLabels
from edge.gateway.scar_watch import ScarWatch

__all__ = ["PressPipeline"]


class PressPipeline:
    """Judges the one frame of each press. on_event gets every contact event. admission: by the overview camera. labels:
    which presses are no part's; the overview camera is not asked about these. scars: of the mounted gel; None leaves
    them out. refusal: why a part may not be judged now, next to that of `labels`."""

    def __init__(
        self,
        detector: PressDetector,
        inspector: Inspector,
        clock: Clock,
        on_event: Callable[[Event], None] = lambda event: None,
        admission: Admission | None = None,
        labels: PressLabels | None = None,
        scars: ScarWatch | None = None,
        refusal: Callable[[], Rejection | None] = lambda: None,
    ) -> None:
        self.detector = detector
        self._inspector = inspector
        self._clock = clock
        self._on_event = on_event
        self._admission = admission
        self._labels = labels
        self._label: PressLabel | None = None
        self._scars = scars
        self._refusal = refusal

    @property
    def tracker(self) -> ContactTracker:
        return self.detector.tracker

    def feed(self, frame: CameraFrame) -> list[Press]:
        """One camera frame; returns an inspection for each press that it completes (at most one)."""
        look = self.detector.feed(frame)
        inspections = self._inspections_for(look.events)
        if self._scars is not None and look.level is not None:
            self._scars.see(self.tracker.state, look.level)
        return inspections

    def use(self, inspector: Inspector) -> None:
        """Judge with this one from now on; the learnt picture of the free gel stays."""
        self._inspector = inspector

    def trigger(self) -> str | None:
        """Request a verdict now; returns why there will be none, or None."""
        refusal = None
        for event in self.tracker.trigger():
            self._on_event(event)
            match event:
                case TriggerWithoutContact():
                    refusal = f"nothing presses the gel ({event.state.value}); trigger while the part is held"
                case TriggerRepeated():
                    refusal = f"this press has its verdict ({event.state.value}); lift and press again"
        return refusal

    def relearn(self) -> list[Press]:
        """Learn the free gel again."""
        return self._inspections_for(self.tracker.relearn())

    def _inspections_for(self, events: Iterable[Event]) -> list[Press]:
        inspections = []
        for event in events:
            self._on_event(event)
            match event:
                case PressBegan():
                    self._begin()
                case PressSettled():
                    inspections.append(self._settled(event))
                case PressNotSettled():
                    text = f"the press gave no still frame: {event.reason.value}; press longer and without sliding"
                    rejected = Verdict.rejected(Rejection(Reason.NOT_SETTLED, text))
                    inspections.append(self._labelled(self._unsettled(rejected)))
        return inspections

    def _begin(self) -> None:
        """What this press is for; a part's is looked at before anything of it is judged."""
        self._label = self._labels.begin() if self._labels is not None else None
        if self._label is None and self._admission is not None:
            self._admission.begin()

    def _unsettled(self, rejected: Verdict) -> Press:
        is_looked_at = self._label is None and self._admission is not None
        view = self._admission.take()[0] if is_looked_at and self._admission else None
        return Press(rejected, overview=view)

    def _labelled(self, inspection: Press) -> Press:
        """With what the press is for; the next one is a part's."""
        label, self._label = self._label, None
        return replace(inspection, label=label) if label is not None else inspection

    def _settled(self, event: PressSettled) -> Press:
        """Judged, unless parts may not be judged now: then it is not scored."""
        if self._label is not None:
            judged = self._labelled(self._judged(event))
            return replace(judged, imprint=self._imprint(event, judged)) if _is_reference(judged) else judged
        refusal = (self._labels.refusal() if self._labels is not None else None) or self._refusal()
        if refusal is not None:
            return self._unsettled(Verdict.rejected(refusal))
        return self._admitted(event)

    def _imprint(self, event: PressSettled, judged: Press) -> Imprint:
        profile, touch = self._inspector.bundle.profile, event.touch
        (x_mm, y_mm), (width, height) = profile.mm_per_pixel, profile.size
        found = judged.registered
        is_turning = found is not None and found.uncertainty.turn_rad is not None
        return Imprint(
            strength_levels=event.strength,
            x_mm=touch.x * width * x_mm,
            y_mm=touch.y * height * y_mm,
            turn_deg=math.degrees(found.pose.turn_rad) if found is not None and is_turning else None,
            noise_levels=None if event.findings is None else event.findings.noise_levels,
        )

    def _admitted(self, event: PressSettled) -> Press:
        """Judged, unless the overview camera refuses the part: then it is not scored."""
        if self._admission is None:
            return self._judged(event)
        view, refusal = self._admission.take()
        judged = Press(Verdict.rejected(refusal)) if refusal else self._judged(event)
        return replace(judged, overview=view)

    def _judged(self, event: PressSettled) -> Press:
        started_ns = self._clock.monotonic_ns()
        frame, found = event.frame, event.findings
        if frame is None or found is None:
            return Press(None, error=f"frame {event.sequence}, chosen for this press, was not kept")
        inspection = self._inspector.inspect(frame, event.touch)
        if self._scars is not None and self._label is not None:
            self._scars.leave_out(found)
        elif self._scars is not None:
            inspection = self._scars.judge(inspection, self._inspector, found)
        total = (self._clock.monotonic_ns() - started_ns) / 1e6
        # A frame that was made on demand has its recorded time.
        judged_ns = started_ns if frame.is_on_demand else frame.timestamp_ns
        judged = JudgedFrame(frame, event.touch, found.free)
        latency_ms = {**inspection.latency_ms, "total": total}
        return replace(inspection, latency_ms=latency_ms, judged_ns=judged_ns, judged=judged)


def _is_reference(inspection: Press) -> bool:
    return isinstance(inspection.label, ReferenceLabel)
