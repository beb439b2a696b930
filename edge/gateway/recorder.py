"""From a judged press to a recorded one: its picture, its result, and the one transaction that keeps both."""

import sqlite3
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.defects import Measured
from edge.core.drawn_regions import region_at
from edge.core.errors import ArchiveError
from edge.core.imaging.decode import decode
from edge.core.imaging.followed_light import FollowedLight
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock, Message
from edge.core.press import AGREED, Again, JudgedFrame, Press, ScarFindings
from edge.core.sink_context import Place
from edge.core.verdict import Blame, Cause, Kind, Verdict
from edge.gateway.pictures import PressDrawing
from edge.messaging.deviation_payload import DeviationPlace, DeviationsPayload
from edge.messaging.payload_base import iso_time
from edge.messaging.result_payload import (
    MOST_DEFECTS,
    DefectPlace,
    PosePlace,
    PressFiles,
    ResultPayload,
    press_messages,
)
from edge.messaging.status_payloads import GelPayload
from edge.model.bundle import Bundle
from edge.model.comparison import compare_press, outline_regions
from edge.model.inspector import Inspector
from edge.pictures.image_file import PictureForm
from edge.pictures.press_picture import PressCaption, encode_press, encode_scores
from edge.press_stage import OwnTable, PressStage
from edge.store.gel_ledger import GelRecord
from edge.store.press_archive import ArchiveFolder
from edge.store.press_store import PressRecord, Recorded, Store

__all__ = ["PressReport", "Recorder", "WaitingPress", "draw_archived", "press_drawing"]


@dataclass(frozen=True)
class WaitingPress:
    """A press as it is written, made once: a repeated write is the same press."""

    press: Press
    """Without its pictures."""
    row: PressRecord
    result: Mapping[str, Any]
    """The fields of the ResultPayload except those from the ledger."""
    drawing: PressDrawing | None
    """Its picture; None where none is published."""
    table: OwnTable | None
    """Where it is kept; None for the history of parts."""

    def draw_now(self) -> "WaitingPress":
        """Draw its picture now, which takes a tenth of the room."""
        return self if self.drawing is None else replace(self, drawing=self.drawing.draw_now())

    def delay(self) -> "WaitingPress":
        """Return it as one that waits for the database: its result is sent late."""
        return replace(self, result={**self.result, "is_replayed": True})


@dataclass(frozen=True)
class PressReport:
    """A press as recorded and as published. A press with a label is not published as a result."""

    press: Press
    result: ResultPayload
    gel: GelRecord
    sentences: Sequence[str] = ()
    """What a master piece's press says of the station."""

    @property
    def word(self) -> str:
        """The verdict, or `error`; `reference` or `study` for a press of a master piece or a study."""
        return self.press.word if self.press.label is None else self.press.label.kind


class Recorder:
    """Writes presses of one sensor, judged at one place in the plant, into the store.

    add_picture: takes the picture of each recorded press, to be drawn. heatmap: its form. keeps_heatmap: the newest one
    is retained. wear_index: the gel's optical wear when it was last free, stored with every press; None until measured.
    """

    wear_index: float | None = None

    def __init__(
        self,
        store: Store,
        serial: str,
        place: Place,
        clock: Clock,
        add_picture: Callable[[PressDrawing], None],
        stages: Sequence[PressStage] = (),
        *,
        heatmap: PictureForm = "jpeg",
        keeps_heatmap: bool = False,
    ) -> None:
        self._store, self._serial, self._place, self._clock = store, serial, place, clock
        self._add_picture, self._stages = add_picture, stages
        self._heatmap, self._keeps_heatmap = heatmap, keeps_heatmap

    def prepare(self, press: Press, inspector: Inspector) -> WaitingPress:
        """Make everything of a press that its place in the ledger does not decide."""
        bundle = inspector.bundle
        for stage in self._stages:
            press = stage.keep(press, inspector)
        row = PressRecord(
            press_id=press.press_id,
            time_ns=press.time_ns,
            serial=self._serial,
            part=bundle.manifest.part,
            position=bundle.manifest.position,
            verdict=press.word,
            score=press.score,
            threshold=bundle.manifest.threshold.value,
            wear_index=self.wear_index,
            second_of=(press.again.second_of or None) if press.again else None,
            cause=press.blame.cause.value if press.blame else None,
            evidence=press.evidence,
            shadow=press.shadow.encode() if press.shadow else None,
            piece_id=press.piece.piece_id if press.piece else None,
        )
        tables = (stage.table(press, row) for stage in self._stages)
        table = next((table for table in tables if table is not None), None)
        is_shown = table is None or table.has_picture
        draw = press_drawing(press, bundle, str(self._place), self._heatmap) if is_shown else None
        result = {
            "site": self._place.site,
            "line": self._place.line,
            "station": self._place.station,
            "sensor_serial": self._serial,
            **_judgement(press, bundle),
            **_defects(press, bundle),
            **_fields(self._stages, press),
            "heatmap_topic": f"heatmap/{press.press_id}" if draw else None,
        }
        drawing = None if draw is None else PressDrawing(press.press_id, draw)
        return WaitingPress(press.drop_pictures(), row, result, drawing, table)

    def record(self, waiting: WaitingPress) -> PressReport:
        """Write press, count and messages in one transaction; `follow` is the rest. Errors: StoreError; the call may
        be repeated."""
        press, table = waiting.press, waiting.table
        sentences: Sequence[str] = ()
        result: ResultPayload | None = None

        def messages(recorded: Recorded) -> Sequence[Message]:
            nonlocal sentences, result
            result = _result(waiting, recorded)
            if table is None:
                still = press.overview.jpeg if press.overview else None
                return press_messages(result, recorded.gel, still, keeps_heatmap=self._keeps_heatmap)
            own, sentences = table.publish(result, recorded.sequence)
            return [*own, GelPayload.of(recorded.gel, result.time_ns).message()]

        def write(connection: sqlite3.Connection) -> None:
            for stage in self._stages if table is None else ():
                stage.write(connection, press)

        owes_picture = waiting.drawing is not None
        recorded = self._store.record_press(waiting.row, messages, table, write, owes_picture=owes_picture)
        return PressReport(press, result or _result(waiting, recorded), recorded.gel, sentences)

    def follow(self, recorded: WaitingPress, gel: GelRecord, unrecorded: int = 0) -> None:
        """Have its picture drawn, and write its count into the second record, with the number of presses that still
        wait, when its result is on its way. Never raises."""
        if recorded.drawing is not None:
            self._add_picture(recorded.drawing)
        self._store.keep_count(gel, unrecorded)

    def count(self, presses: int) -> GelRecord:
        """Count presses that have no result. Errors: StoreError."""
        return self._store.count_presses(self._serial, presses, self._clock.time_ns())


def press_drawing(
    press: Press, bundle: Bundle, station: str, heatmap: PictureForm
) -> Callable[[], PressFiles] | None:
    """Return what draws a press as it is published; None for one without a score. station: site/line/station."""
    rgb, score_map = press.rgb, press.score_map
    if rgb is None or score_map is None or press.score is None:
        return None
    manifest = bundle.manifest
    caption = PressCaption(
        press_id=press.press_id,
        verdict=press.word,
        score=press.score,
        threshold=manifest.threshold.value,
        mm_per_pixel=bundle.profile.mm_per_pixel,
        station=station,
        part="/".join(word for word in (manifest.part, manifest.position) if word),
        time=iso_time(press.time_ns),
        drawn=manifest.regions.describe() if manifest.regions else "",
    )
    measure = press.measure

    def draw() -> PressFiles:
        pose = None if press.registered is None else press.registered.pose
        dimmed = _dim_unjudged(rgb, press, bundle)
        sheet = partial(encode_press, dimmed, score_map, form=heatmap, outlines=outline_regions(bundle, pose))
        is_asked = press.word != Kind.PASS.value  # why a press passes nobody asks
        lit = rgb if press.light is None else press.light.restore(rgb, bundle.region, bundle.profile.size)
        compared = compare_press(bundle, lit, score_map, press.registered) if is_asked else None
        measured = None if measure is None else _deviations(measure(), press)
        full_caption = caption if measured is None else caption._replace(deviation=str(measured.first))
        return PressFiles(
            sheet(caption=full_caption, compared=compared), encode_scores(score_map, full_caption), measured
        )

    return draw


def draw_archived(
    press_id: str,
    store: Store,
    bundles: Iterable[Bundle],
    heatmap: PictureForm,
    stages: Iterable[PressStage] = (),
) -> PressFiles:
    """Draw a recorded press again, from what its verdict was made from: the same pictures, byte for byte.

    Nothing is scored, so another thread than that of the scorer may call it. Errors: ArchiveError for a press that is
    not in the archive, or whose bundle is not open; StoreError.
    """
    query = "SELECT evidence FROM presses WHERE press_id = ?"
    row = store.read(f"finding press {press_id}", lambda c: c.execute(query, (press_id,)).fetchone())
    archive = ArchiveFolder(store.path.with_suffix(".archive"))
    then = archive.press(press_id, row[0] if row else None)
    bundle = next((bundle for bundle in bundles if bundle.digest == then.bundle_id), None)
    if bundle is None:
        raise ArchiveError(f"the bundle {then.bundle_id} that judged press {press_id} is not open any more")
    frame = archive.read(then.frame, f"the judged frame of press {press_id}")
    picture = decode(CameraFrame(frame, 0, 0, is_on_demand=True), bundle.profile)
    rgb = np.ascontiguousarray(bundle.region.crop(picture))
    part, prepared = bundle.registration, bundle.prepare(rgb)
    light = None if then.light is None else FollowedLight(*then.light)
    prepared = prepared if light is None else light.restore(prepared, bundle.region, bundle.profile.size)
    blame, level = Blame(Cause.UNSURE, "see the recorded result"), AGREED * bundle.manifest.threshold.value
    press = Press(
        press_id=press_id,
        time_ns=then.time_ns,
        rgb=rgb,
        score_map=archive.read_map(then),
        verdict=Verdict(Kind(then.verdict), then.score, then.threshold, 0.0),
        registered=None if part is None else part.open().register(prepared),
        light=light,
        scars=None if then.masked is None else ScarFindings(blame, archive.read_masked(then)),
        judged=JudgedFrame(CameraFrame(frame, 0, 0), Touch(*then.touch), archive.read_reference(then)),
        again=None if then.own_score is None else Again("", is_asked=False, shown_from=level),
    )
    for stage in stages:
        press = stage.draw_again(press, bundle)
    draw = press_drawing(press, bundle, then.station, heatmap)
    return PressFiles() if draw is None else draw()


def _deviations(measured: Measured, press: Press) -> DeviationsPayload:
    return DeviationsPayload(
        time_ns=press.time_ns,
        press_id=press.press_id,
        calibration=measured.calibration,
        reason=measured.reason or None,
        deviations=[DeviationPlace.of(deviation) for deviation in measured.deviations],
    )


def _dim_unjudged(rgb: NDArray[np.uint8], press: Press, bundle: Bundle) -> NDArray[np.uint8]:
    """Return the picture with the places that were not judged at half their light."""
    unseen = None if press.registered is None else press.registered.unseen_in_press
    masked = None if press.scars is None else press.scars.masked
    blind = bundle.blind
    if blind is not None and press.registered is not None:
        blind = press.registered.mask_in_press(blind)
    for unjudged in (unseen, masked, blind):
        if unjudged is not None:
            rgb = np.where(unjudged[..., None], rgb // 2, rgb)
    return rgb


def _judgement(press: Press, bundle: Bundle) -> Mapping[str, Any]:
    """Return the fields of a result that say what became of the press, by which bundle, and why."""
    manifest, score = bundle.manifest, press.score
    threshold, mm_per_pixel = manifest.threshold.value, bundle.profile.mm_per_pixel
    placed = press.registered
    return {
        "press_id": press.press_id,
        "time_ns": press.time_ns,
        "part": manifest.part,
        "position": manifest.position,
        "mm_per_pixel": mm_per_pixel,
        "method": manifest.method,
        "bundle_id": bundle.digest,
        "verdict": None if press.verdict is None else press.verdict.kind,
        "reason": press.reason,
        "error": press.error if press.verdict is None else None,
        "score": score,
        "threshold": threshold,
        "tolerance": press.verdict.tolerance if press.verdict else None,
        # At a threshold of 0 or below there is no such scale.
        "score_ratio": score / threshold if score is not None and threshold > 0 else None,
        "is_at_rest": press.is_at_rest,
        "latency_ms": press.latency_ms,
        "light_gain": None if press.light is None else press.light.gain,
        "pose": None if placed is None else PosePlace.of(placed, mm_per_pixel),
    }


def _defects(press: Press, bundle: Bundle) -> Mapping[str, Any]:
    """Return where the press exceeds the threshold, or what is decided by; nothing for a pass and without a score."""
    if press.score_map is None or press.verdict is None or press.verdict.kind is Kind.PASS:
        return {}
    defects = press.find_places(bundle.manifest.threshold.value)
    x_mm, y_mm = bundle.profile.mm_per_pixel
    regions = bundle.manifest.regions.regions if bundle.manifest.regions else ()
    pose = None if press.registered is None else press.registered.pose
    scale, frame = bundle.profile.mm_per_pixel, bundle.manifest.frame
    around = [region_at(regions, defect.centroid_px, scale, frame, pose) for defect in defects[:MOST_DEFECTS]]
    return {
        "defects": [
            DefectPlace.of(defect, x_mm, y_mm, None if region is None else region.name)
            for defect, region in zip(defects, around, strict=False)
        ],
        "defect_area_mm2": round(sum(defect.area_px for defect in defects) * x_mm * y_mm, 4),
    }


def _fields(stages: Iterable[PressStage], press: Press) -> Mapping[str, Any]:
    """Return what the stages have to say; a feature of another package cannot change what gelgate says."""
    ours: dict[str, Any] = {}
    others: dict[str, Mapping[str, Any]] = {}
    for stage in stages:
        fields = stage.fields(press)
        if stage.foreign_name is None:
            ours |= fields
        elif fields:
            others[stage.foreign_name] = fields
    return {**ours, "feature": others}


def _result(waiting: WaitingPress, recorded: Recorded) -> ResultPayload:
    gel = recorded.gel
    return ResultPayload(
        **waiting.result,
        sequence=recorded.sequence if waiting.press.label is None else None,
        gel_id=gel.gel_id,
        gel_serial=gel.gel_serial,
        gel_presses=gel.presses,
        gel_limit_presses=gel.limit_presses,
        ledger_head=str(recorded.head),
    )
