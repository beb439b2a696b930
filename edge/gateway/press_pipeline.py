"""From frames to judged presses: contact finds the press, the stages admit it, the inspector scores its one frame."""

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
from edge.core.press_label import PressLabel
from edge.gateway.inspector import Inspector
from edge.gateway.press_stage import PressStage
from edge.store.ulid import new_ulid

__all__ = ["PressPipeline"]


class PressPipeline:
    """Judges the one frame of each press. stages: all around the score. on_event: gets each contact event first."""

    def __init__(
        self,
        detector: PressDetector,
        inspector: Inspector,
        clock: Clock,
        stages: PressStage | None = None,
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self.detector = detector
        self._inspector = inspector
        self._clock = clock
        self._stages = stages or PressStage()
        self._on_event = on_event
        self._label: PressLabel | None = None

    @property
    def tracker(self) -> ContactTracker:
        return self.detector.tracker

    def feed(self, frame: CameraFrame) -> list[Press]:
        """One camera frame; returns the presses that it completes (at most one)."""
        look = self.detector.feed(frame)
        presses = self._presses_of(look.events)
        self._stages.look(look)
        return presses

    def use(self, inspector: Inspector) -> None:
        """Judge with this one from now on; the learnt picture of the free gel stays."""
        self._inspector = inspector

    def trigger(self) -> str | None:
        """Request a verdict now; returns why there will be none, or None."""
        refusal = None
        for event in self.tracker.trigger():
            self._see(event)
            match event:
                case TriggerWithoutContact():
                    refusal = f"nothing presses the gel ({event.state.value}); trigger while the part is held"
                case TriggerRepeated():
                    refusal = f"this press has its verdict ({event.state.value}); lift and press again"
        return refusal

    def relearn(self) -> list[Press]:
        """Learn the free gel again."""
        self._stages.relearn()
        return self._presses_of(self.tracker.relearn())

    def _see(self, event: Event) -> None:
        self._on_event(event)
        self._stages.see(event)

    def _presses_of(self, events: Iterable[Event]) -> list[Press]:
        presses = []
        for event in events:
            self._see(event)
            match event:
                case PressBegan():
                    self._label = self._stages.begin(None)
                case PressSettled():
                    presses.append(self._judge(Press(), event))
                case PressNotSettled():
                    text = f"the press gave no still frame: {event.reason.value}; press longer and without sliding"
                    presses.append(self._judge(Press().reject(Rejection(Reason.NOT_SETTLED, text)), None))
        return presses

    def _judge(self, press: Press, settled: PressSettled | None) -> Press:
        """Admit it, score it unless that decided it, and let the stages judge it; the next press is a part's."""
        time_ns = self._clock.time_ns()
        press = self._stages.admit(
            replace(press, label=self._label, press_id=new_ulid(time_ns), time_ns=time_ns)
        )
        self._label = None
        if settled is None or press.is_decided:
            return self._stages.judge(press, None, self._inspector)
        started_ns = self._clock.monotonic_ns()
        judged = self._stages.judge(self._score(press, settled, started_ns), settled, self._inspector)
        total_ms = (self._clock.monotonic_ns() - started_ns) / 1e6
        return replace(judged, latency_ms={**judged.latency_ms, "total": total_ms})

    def _score(self, press: Press, settled: PressSettled, started_ns: int) -> Press:
        frame, found = settled.frame, settled.findings
        if frame is None or found is None:
            return replace(press, error=f"frame {settled.sequence}, chosen for this press, was not kept")
        scored = self._inspector.inspect(frame, settled.touch)
        return replace(
            scored,
            label=press.label,
            overview=press.overview,
            press_id=press.press_id,
            time_ns=press.time_ns,
            # A frame that was made on demand has its recorded time.
            judged_ns=started_ns if frame.is_on_demand else frame.timestamp_ns,
            judged=JudgedFrame(frame, settled.touch, found.free),
        )
