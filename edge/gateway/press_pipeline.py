"""From frames to judged presses: contact finds the press, the inspector judges its one frame."""

from collections.abc import Callable
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
from edge.core.verdict import Verdict
from edge.gateway.admission import Admission
from edge.gateway.inspector import Inspection, Inspector, JudgedFrame

__all__ = ["PressPipeline"]


class PressPipeline:
    """Judges the one frame of each press. on_event gets every contact event. admission: by the overview camera."""

    def __init__(
        self,
        detector: PressDetector,
        inspector: Inspector,
        clock: Clock,
        on_event: Callable[[Event], None] = lambda event: None,
        admission: Admission | None = None,
    ) -> None:
        self.detector = detector
        self._inspector = inspector
        self._clock = clock
        self._on_event = on_event
        self._admission = admission

    @property
    def tracker(self) -> ContactTracker:
        return self.detector.tracker

    def feed(self, frame: CameraFrame) -> list[Inspection]:
        """One camera frame; returns an inspection for each press that it completes (at most one)."""
        return self._inspections_for(self.detector.feed(frame))

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

    def relearn(self) -> list[Inspection]:
        """Learn the free gel again."""
        return self._inspections_for(self.tracker.relearn())

    def _inspections_for(self, events: list[Event]) -> list[Inspection]:
        inspections = []
        for event in events:
            self._on_event(event)
            match event:
                case PressBegan() if self._admission is not None:
                    self._admission.begin()
                case PressSettled():
                    inspections.append(self._admitted(event))
                case PressNotSettled():
                    text = f"the press gave no still frame: {event.reason.value}; press longer and without sliding"
                    rejected = Verdict.rejected(Rejection(Reason.NOT_SETTLED, text))
                    view = self._admission.take()[0] if self._admission else None
                    inspections.append(Inspection(rejected, overview=view))
        return inspections

    def _admitted(self, event: PressSettled) -> Inspection:
        """Judged, unless the overview camera refuses the part: then it is not scored."""
        if self._admission is None:
            return self._judged(event)
        view, refusal = self._admission.take()
        judged = Inspection(Verdict.rejected(refusal)) if refusal else self._judged(event)
        return replace(judged, overview=view)

    def _judged(self, event: PressSettled) -> Inspection:
        started_ns = self._clock.monotonic_ns()
        frame = self.detector.chosen(event)
        if frame is None:
            return Inspection(None, error=f"frame {event.sequence}, chosen for this press, was not kept")
        inspection = self._inspector.inspect(frame, event.touch)
        total = (self._clock.monotonic_ns() - started_ns) / 1e6
        # A frame that was made on demand has its recorded time.
        judged_ns = started_ns if frame.is_on_demand else frame.timestamp_ns
        reference = self.tracker.reference
        judged = JudgedFrame(frame, event.touch, None if reference is None else reference.view)
        latency_ms = {**inspection.latency_ms, "total": total}
        return replace(inspection, latency_ms=latency_ms, judged_ns=judged_ns, judged=judged)
