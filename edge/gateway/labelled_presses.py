"""Presses that are no part's: the table that keeps them, and what is published of them."""

import sqlite3
from collections.abc import Sequence

from edge.core.ports import Message
from edge.core.press_label import PressLabel, ReferenceLabel, StudyLabel
from edge.core.reference_press.charts import Judgement, ReferencePress, judge
from edge.core.reference_press.measures import Imprint
from edge.messaging.gel_payload import GelPayload, gel_message
from edge.messaging.reference_payload import ReferencePayload, reference_message
from edge.messaging.result_payload import ResultPayload, heatmap_message
from edge.store.press_store import PressRecord, PressTable, Recorded
from edge.store.reference_presses import PieceKey, ReferenceTable
from edge.store.study_presses import StudyTable

__all__ = ["LabelledTable", "labelled_table"]


class LabelledTable:
    """The `PressTable` of one press with a label. judgement: of a master piece's, once it is inserted."""

    def __init__(self, label: PressLabel, table: ReferenceTable | StudyTable) -> None:
        self.judgement: Judgement | None = None
        self._label = label
        self._table: PressTable = table

    @property
    def name(self) -> str:
        return self._table.name

    @property
    def sentences(self) -> tuple[str, ...]:
        """What it says of the station."""
        return () if self.judgement is None else self.judgement.sentences

    def insert(self, connection: sqlite3.Connection, press: PressRecord, gel_id: str, running_ns: int) -> int:
        number = self._table.insert(connection, press, gel_id, running_ns)
        if isinstance(self._table, ReferenceTable) and isinstance(self._label, ReferenceLabel):
            self.judgement = judge(self._table.presses, self._label.learn)
        return number

    def messages(
        self, result: ResultPayload, recorded: Recorded, heatmap_png: bytes | None
    ) -> Sequence[Message]:
        """A master piece's press with its charts and picture; of a study nothing, for who presses must not see it; the
        gel in both cases."""
        gel = gel_message(GelPayload.of(recorded.gel, result.time_ns))
        label, judgement = self._label, self.judgement
        if judgement is None or not isinstance(label, ReferenceLabel):
            return [gel]
        payload = ReferencePayload.of(result, recorded.sequence, label.piece, label.expected, judgement)
        picture = [] if heatmap_png is None else [heatmap_message(result.press_id, heatmap_png)]
        return [*picture, reference_message(payload), gel]


def labelled_table(
    label: PressLabel, press: PressRecord, imprint: Imprint | None, reason: str | None, bundle_id: str
) -> LabelledTable:
    """reason: why the press was rejected or has no score."""
    if isinstance(label, StudyLabel):
        step = (label.study_id, label.step, label.piece, label.operator, label.repeat)
        return LabelledTable(label, StudyTable(*step, bundle_id, reason))
    key = PieceKey(press.serial, press.part, press.position or "", label.piece)
    one = ReferencePress(
        press.press_id,
        press.time_ns,
        "",  # the gel is known once the press is counted
        bundle_id,
        label.expected,
        press.verdict,
        press.score,
        press.threshold,
        imprint or Imprint(),
        reason,
        label.is_start,
    )
    return LabelledTable(label, ReferenceTable(key, one))
