"""From frames to recorded presses: contact finds the press, the inspector judges it, one transaction records it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from edge.core.contact.events import (
    Event,
    PressNotSettled,
    PressSettled,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.tracker import ContactTracker
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Reason, Rejection
from edge.core.ports import Clock
from edge.core.press_detector import PressDetector
from edge.core.verdict import Verdict
from edge.gateway.heatmap import overlay_png
from edge.gateway.inspector import Inspection, Inspector
from edge.messaging.payloads import ResultPayload, press_messages
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import Press, Store
from edge.store.ulid import new_ulid

__all__ = ["PressReport", "PressTaker", "Recorder"]


@dataclass(frozen=True)
class PressReport:
    """One press as it was recorded and as it will be published."""

    result: ResultPayload
    gel: GelRecord
    heatmap_png: bytes | None


class Recorder:
    """Writes presses of one sensor, judged with one bundle, into the store.

    wear_index: the gel's optical wear when it was last seen free, noted with every press; None until measured.
    """

    wear_index: float | None = None

    def __init__(self, store: Store, inspector: Inspector, serial: str, clock: Clock) -> None:
        self._store = store
        self._bundle = inspector.bundle
        self._serial = serial
        self._clock = clock

    def prepare(
        self, inspection: Inspection
    ) -> tuple[Press, Callable[[GelRecord], ResultPayload], bytes | None]:
        """Everything of a press but its place in the ledger, made once so that a repeated write is the same press."""
        time_ns = self._clock.time_ns()
        manifest, verdict = self._bundle.manifest, inspection.verdict
        heatmap = self._heatmap(inspection)
        press = Press(
            press_id=new_ulid(time_ns),
            time_ns=time_ns,
            serial=self._serial,
            part=manifest.part,
            position=manifest.position,
            verdict="error" if verdict is None else verdict.kind.value,
            score=verdict.score if verdict else None,
            threshold=manifest.threshold.value,
            wear_index=self.wear_index,
        )
        rejection = verdict.rejection if verdict else None

        def result(gel: GelRecord) -> ResultPayload:
            return ResultPayload(
                press_id=press.press_id,
                time_ns=time_ns,
                part=press.part,
                position=press.position,
                verdict=None if verdict is None else verdict.kind,
                reason=f"{rejection.reason.value}: {rejection.text}" if rejection else None,
                error=inspection.error if verdict is None else None,
                score=press.score,
                threshold=press.threshold,
                tolerance=verdict.tolerance if verdict else None,
                method=manifest.method,
                bundle_id=self._bundle.digest,
                sensor_serial=self._serial,
                gel_id=gel.gel_id,
                gel_presses=gel.presses,
                gel_limit_presses=gel.limit_presses,
                latency_ms=inspection.latency_ms,
                heatmap_topic=f"heatmap/{press.press_id}" if heatmap else None,
            )

        return press, result, heatmap

    def record(
        self, press: Press, result: Callable[[GelRecord], ResultPayload], heatmap: bytes | None
    ) -> PressReport:
        """One transaction: the press, its count, its messages. Errors: StoreError; the same call may be repeated."""
        gel = self._store.record_press(press, lambda gel: press_messages(result(gel), gel, heatmap))
        return PressReport(result(gel), gel, heatmap)

    def _heatmap(self, inspection: Inspection) -> bytes | None:
        if inspection.rgb is None or inspection.score_map is None:
            return None
        return overlay_png(inspection.rgb, inspection.score_map, self._bundle.manifest.threshold.value)


class PressTaker:
    """Judges the one frame that each press gives. on_event hears every contact event."""

    def __init__(
        self,
        detector: PressDetector,
        inspector: Inspector,
        clock: Clock,
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self.detector = detector
        self._inspector = inspector
        self._clock = clock
        self._on_event = on_event

    @property
    def tracker(self) -> ContactTracker:
        return self.detector.tracker

    def feed(self, frame: CameraFrame) -> list[Inspection]:
        """One camera frame; gives an inspection for each press that it decides (at most one)."""
        return self._told(self.detector.feed(frame))

    def trigger(self) -> str | None:
        """A verdict is asked for now; gives why there will be none, or None."""
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
        """Learn the free gel anew."""
        return self._told(self.tracker.relearn())

    def _told(self, events: list[Event]) -> list[Inspection]:
        inspections = []
        for event in events:
            self._on_event(event)
            match event:
                case PressSettled():
                    inspections.append(self._judged(event))
                case PressNotSettled():
                    text = f"the press gave no still frame: {event.reason.value}; press longer and without sliding"
                    rejected = Verdict.rejected(Rejection(Reason.NOT_SETTLED, text))
                    inspections.append(Inspection(rejected))
        return inspections

    def _judged(self, event: PressSettled) -> Inspection:
        started_ns = self._clock.monotonic_ns()
        frame = self.detector.chosen(event)
        if frame is None:
            return Inspection(None, error=f"frame {event.sequence}, chosen for this press, was not kept")
        inspection = self._inspector.inspect(frame, event.touch)
        total = (self._clock.monotonic_ns() - started_ns) / 1e6
        return replace(inspection, latency_ms={**inspection.latency_ms, "total": total})
