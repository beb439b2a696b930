"""From a judged press to a recorded one: its picture, its result, and the one transaction that keeps both."""

from dataclasses import dataclass, replace
from typing import Any

from edge.core.defects import Defect, find_defects
from edge.core.ports import Clock
from edge.core.press import Press
from edge.core.press_label import PressLabel
from edge.core.reference_press.measures import Imprint
from edge.core.sink_context import Place
from edge.core.verdict import Kind
from edge.gateway.black_box import BlackBox
from edge.gateway.heatmaps import heatmap_png
from edge.gateway.inspector import Inspector
from edge.gateway.labelled_presses import LabelledTable, labelled_table
from edge.messaging.defect_place import DefectPlace
from edge.messaging.pose_payload import PosePlace
from edge.messaging.press_again_payload import PressAgainPart
from edge.messaging.result_payload import MOST_DEFECTS, ResultPayload, press_messages
from edge.model.bundle import Bundle
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord, Recorded, Store

__all__ = ["JudgedPress", "PressReport", "Recorder"]


@dataclass(frozen=True)
class JudgedPress:
    """One press with everything known before it is counted, made once: a repeated write is the same press.

    result: the fields of the ResultPayload except those from the ledger. judged_ns: of its inspection.
    """

    press: PressRecord
    result: dict[str, Any]
    heatmap_png: bytes | None
    overview_jpeg: bytes | None = None
    judged_ns: int | None = None
    label: PressLabel | None = None
    imprint: Imprint | None = None


@dataclass(frozen=True)
class PressReport:
    """One press as recorded and as published. judged_ns: when the judged frame came, monotonic; None without one.
    label: what it was for, None for a part's; such a press is not published as a result. sentences: what it says of the
    station, for a master piece's."""

    result: ResultPayload
    gel: GelRecord
    heatmap_png: bytes | None
    judged_ns: int | None = None
    label: PressLabel | None = None
    sentences: tuple[str, ...] = ()

    @property
    def word(self) -> str:
        """The verdict, or `error`; `reference` or `study` for a press that is no part's."""
        if self.label is not None:
            return self.label.kind
        return "error" if self.result.verdict is None else self.result.verdict.value


class Recorder:
    """Writes presses of one sensor, judged at one place in the plant, into the store.

    wear_index: the gel's optical wear when it was last free, stored with every press; None until measured.
    """

    wear_index: float | None = None

    def __init__(
        self,
        store: Store,
        inspector: Inspector,
        serial: str,
        place: Place,
        clock: Clock,
        black_box: BlackBox | None = None,
    ) -> None:
        self._store = store
        self._inspector = inspector
        self._black_box = black_box
        self._serial = serial
        self._place = place
        self._clock = clock

    def use(self, inspector: Inspector) -> None:
        """It judges the presses from now on."""
        self._inspector = inspector

    @property
    def _bundle(self) -> Bundle:
        return self._inspector.bundle

    def prepare(self, inspection: Press) -> JudgedPress:
        """Everything of a press except its place in the ledger."""
        press = self._archived(self._press(inspection), inspection)
        heatmap = heatmap_png(press, inspection, self._bundle, str(self._place))
        still = inspection.overview.jpeg if inspection.overview else None
        result = {
            **self._origin(press),
            **_judgement(press, inspection),
            **self._defects(inspection),
            **_overview(inspection),
            **self._pose(inspection),
            **_again(inspection),
            **_scars(inspection),
            "heatmap_topic": f"heatmap/{press.press_id}" if heatmap else None,
            "overview_topic": f"overview/{press.press_id}" if still else None,
        }
        return JudgedPress(
            press, result, heatmap, still, inspection.judged_ns, inspection.label, inspection.imprint
        )

    def record(self, judged: JudgedPress) -> PressReport:
        """One transaction: the press, its count, its messages. Errors: StoreError; the same call may be repeated."""
        made: list[ResultPayload] = []
        table = self._table_of(judged)

        def messages(recorded: Recorded) -> Any:
            made.append(_result(judged, recorded))
            if table is not None:
                return table.messages(made[-1], recorded, judged.heatmap_png)
            return press_messages(made[-1], recorded.gel, judged.heatmap_png, judged.overview_jpeg)

        recorded = self._store.record_press(judged.press, messages, table)
        # No messages are made for a press that the database already has.
        result = made[-1] if made else _result(judged, recorded)
        said = table.sentences if table is not None else ()
        return PressReport(result, recorded.gel, judged.heatmap_png, judged.judged_ns, judged.label, said)

    def _table_of(self, judged: JudgedPress) -> LabelledTable | None:
        """None for the history of parts."""
        if judged.label is None:
            return None
        reason = judged.result["reason"] or judged.result["error"]
        return labelled_table(judged.label, judged.press, judged.imprint, reason, judged.result["bundle_id"])

    def count(self, presses: int) -> GelRecord:
        """Count presses that have no result. Errors: StoreError."""
        return self._store.count_presses(self._serial, presses, self._clock.time_ns())

    def _press(self, inspection: Press) -> PressRecord:
        manifest, verdict = self._bundle.manifest, inspection.verdict
        return PressRecord(
            press_id=inspection.press_id,
            time_ns=inspection.time_ns,
            serial=self._serial,
            part=manifest.part,
            position=manifest.position,
            verdict=inspection.word,
            score=verdict.score if verdict else None,
            threshold=manifest.threshold.value,
            wear_index=self.wear_index,
            second_of=(inspection.again.second_of or None) if inspection.again else None,
            cause=inspection.blame.cause.value if inspection.blame else None,
        )

    def _archived(self, press: PressRecord, inspection: Press) -> PressRecord:
        """The same with what is kept of it; presses of master pieces and of studies are not archived."""
        if self._black_box is None or inspection.label is not None:
            return press
        return replace(press, evidence=self._black_box.keep(press, inspection, self._inspector))

    def _origin(self, press: PressRecord) -> dict[str, Any]:
        """Fields of a result that say what was pressed, when, where and with what."""
        return {
            "press_id": press.press_id,
            "time_ns": press.time_ns,
            "site": self._place.site,
            "line": self._place.line,
            "station": self._place.station,
            "part": press.part,
            "position": press.position,
            "mm_per_pixel": self._bundle.profile.mm_per_pixel,
            "method": self._bundle.manifest.method,
            "bundle_id": self._bundle.digest,
            "sensor_serial": press.serial,
        }

    def _pose(self, inspection: Press) -> dict[str, Any]:
        """The field `pose`; none where presses are scored as they lie."""
        found = inspection.registered
        return {} if found is None else {"pose": PosePlace.of(found, self._bundle.profile.mm_per_pixel)}

    def _defects(self, inspection: Press) -> dict[str, Any]:
        """The fields `defects` and `defect_area_mm2`; none for a pass and for a press without a score."""
        if inspection.score_map is None or inspection.verdict is None or inspection.verdict.kind is Kind.PASS:
            return {}
        found = find_defects(inspection.score_map, self._bundle.manifest.threshold.value)
        x_mm, y_mm = self._bundle.profile.mm_per_pixel
        return {
            "defects": [_defect_place(defect, x_mm, y_mm) for defect in found[:MOST_DEFECTS]],
            "defect_area_mm2": round(sum(defect.area_px for defect in found) * x_mm * y_mm, 4),
        }


def _scars(inspection: Press) -> dict[str, Any]:
    """Fields of a result that say whether gel or part is the cause, and what the gel hides."""
    scars = inspection.scars
    if scars is None:
        return {}
    blame = inspection.blame
    return {
        "cause": blame.cause if blame else None,
        "cause_text": blame.why if blame else None,
        "blind_area_mm2": round(scars.blind_mm2, 4),
        "blind_share": round(scars.blind_share, 4),
        "unmasked_score": scars.score,
    }


def _result(judged: JudgedPress, recorded: Recorded) -> ResultPayload:
    gel = recorded.gel
    return ResultPayload(
        **judged.result,
        sequence=recorded.sequence if judged.label is None else None,
        gel_id=gel.gel_id,
        gel_presses=gel.presses,
        gel_limit_presses=gel.limit_presses,
        ledger_head=str(recorded.head),
    )


def _judgement(press: PressRecord, inspection: Press) -> dict[str, Any]:
    """Fields of a result that say what became of the press, and why."""
    verdict = inspection.verdict
    rejection = verdict.rejection if verdict else None
    return {
        "verdict": None if verdict is None else verdict.kind,
        "reason": f"{rejection.reason.value}: {rejection.text}" if rejection else None,
        "error": inspection.error if verdict is None else None,
        "score": press.score,
        "threshold": press.threshold,
        "tolerance": verdict.tolerance if verdict else None,
        "score_ratio": _ratio(press),
        "latency_ms": inspection.latency_ms,
    }


def _overview(inspection: Press) -> dict[str, Any]:
    """Fields of a result that say what the overview camera saw."""
    view = inspection.overview
    if view is None:
        return {}
    return {"part_codes": [code.text for code in view.codes], "part_present": view.is_present}


def _again(inspection: Press) -> dict[str, Any]:
    """The field `press_again`; none for a press that has nothing to do with another one."""
    again = inspection.again
    if again is None:
        return {}
    part = PressAgainPart(
        is_asked=again.is_asked,
        second_of=again.second_of or None,
        first_score=again.first_score,
        reason=again.reason,
    )
    return {"press_again": part}


def _ratio(press: PressRecord) -> float | None:
    """None where there is no such scale."""
    if press.score is None or press.threshold is None or press.threshold <= 0:
        return None
    return press.score / press.threshold


def _defect_place(defect: Defect, x_mm: float, y_mm: float) -> DefectPlace:
    """In micrometres' precision: finer than any pixel, and short in JSON."""
    left, top, width, height = defect.box_px
    x, y = defect.centroid_px
    return DefectPlace(
        box_px=defect.box_px,
        box_mm=(round(left * x_mm, 3), round(top * y_mm, 3), round(width * x_mm, 3), round(height * y_mm, 3)),
        centroid_px=(round(x, 1), round(y, 1)),
        centroid_mm=(round(x * x_mm, 3), round(y * y_mm, 3)),
        area_mm2=round(defect.area_px * x_mm * y_mm, 4),
        score=defect.score,
    )
