"""What each verdict was made from goes into the archive, so that it can be made again."""

import hashlib
import io
from dataclasses import replace
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Reason
from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.model.inspector import Inspector
from edge.model.session import fingerprint, fingerprint_bytes
from edge.press_stage import Alarms, PressStage, StageParts
from edge.store.gel_ledger import GelRecord
from edge.store.person_verdicts import read_spoken_of
from edge.store.press_archive import ArchivedPress, PressArchive, map_bytes, mask_bytes, read_archived
from edge.store.press_store import Store

__all__ = ["BlackBox"]


class BlackBox(PressStage):
    """Keeps judged presses of parts, not those of master pieces and of studies. station: site/line/station."""

    def __init__(
        self, archive: PressArchive, store: Store, station: str, threads: int, alarms: Alarms
    ) -> None:
        self._archive, self._store, self._station = archive, store, station
        self._threads, self._alarms = threads, alarms
        self._newest_word = 0
        self._serial = ""
        self._machine: tuple[str, bytes] | None = None
        self._reference: tuple[View, tuple[str, bytes]] | None = None
        self._frame: tuple[str, bytes] = "", b""
        self._map: tuple[NDArray[np.float32] | None, tuple[str, bytes]] = None, ("", b"")
        self._unwritten: tuple[ArchivedPress, dict[str, bytes]] | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """The archive is next to the database."""
        config, table = parts.config, parts.config.archive
        folder, most_bytes = config.store.path.with_suffix(".archive"), round(table.mb * 1e6)
        archive = PressArchive(folder, table.presses, most_bytes, parts.find_low_space)
        place, threads = str(config.station.place), config.inspection.threads
        return cls(archive, parts.store, place, threads, parts.alarms)

    def mount(self, gel: GelRecord) -> None:
        """Read what is there, and describe the machine: no press waits for that."""
        self._serial = gel.serial
        newest = partial(read_archived, most=self._archive.most_presses)
        self._archive.open(self._store.read("reading what is archived", newest))
        if self._machine is None:
            self._machine = _name_by_hash(fingerprint_bytes(fingerprint(self._threads)))

    def expect(self, frame: CameraFrame, examined: Press) -> None:
        """Hash ahead what its verdict would be made from."""
        self._frame = _name_by_hash(frame.payload)
        if examined.score_map is not None:
            self._name_map(examined.score_map)

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """Return it with the SHA-256 of its record, which is written when the press is in the database; as it was
        without a judged frame, and where it cannot be kept."""
        judged = press.judged
        # A frame that was too old then is not made again.
        is_late = (press.reason or "").startswith(f"{Reason.STALE.value}:")
        if judged is None or press.label is not None or inspector.fault is not None or is_late:
            return press
        assert self._machine is not None
        if self._frame[1] is not judged.frame.payload:
            self._frame = _name_by_hash(judged.frame.payload)
        frame, machine = self._frame, self._machine
        reference = None if judged.reference is None else self._reference_now(judged.reference)
        score_map = None if press.score_map is None else self._name_map(press.score_map)
        scars, again, manifest = press.scars, press.again, inspector.bundle.manifest
        masked = None if scars is None or scars.masked is None else _name_by_hash(mask_bytes(scars.masked))
        record = ArchivedPress(
            press_id=press.press_id,
            time_ns=press.time_ns,
            station=self._station,
            serial=self._serial,
            part=manifest.part,
            position=manifest.position,
            bundle_id=press.bundle_id,
            revision=manifest.revision,
            threads=self._threads,
            machine=machine[0],
            frame=frame[0],
            touch=(judged.touch.area, judged.touch.x, judged.touch.y),
            reference=reference[0] if reference else None,
            verdict=press.word,
            reason=press.reason,
            error=press.error,
            score=press.score,
            threshold=manifest.threshold.value,
            score_map=score_map[0] if score_map else None,
            asked_up_to=again.bound if again else None,
            first_score=again.first_score if again else None,
            own_score=again.own_score if again else None,
            map_shape=None if press.score_map is None else press.score_map.shape,
            masked=masked[0] if masked else None,
            light=None if press.light is None else press.light.record(),
            is_too_blind=scars is not None and scars.is_too_blind,
        )
        kept = (frame, machine, reference, score_map, masked)
        self._write()  # the press before, which the store has not taken yet
        self._unwritten = record, dict(path for path in kept if path is not None)
        self._frame, self._map = ("", b""), (None, ("", b""))
        # After a fault the archive comes first: no press then names a record that is not there.
        is_sound = self._archive.fault is None and self._archive.why_not() is None
        return replace(press, evidence=record.sha256() if is_sound else self._write())

    def record(self, press: Press, gel: GelRecord) -> None:
        """Write its record: a result does not wait for files. Errors: StoreError."""
        query = partial(read_spoken_of, after=self._newest_word)
        self._newest_word, spoken_of = self._store.read("reading of which presses people spoke", query)
        self._archive.keep_longer(spoken_of)
        self._write()

    def close(self) -> None:
        self._write()

    def _write(self) -> bytes | None:
        """Write what is not written yet; returns the SHA-256 of its record, None where it could not be written."""
        if self._unwritten is None:
            return None
        unwritten, self._unwritten = self._unwritten, None
        evidence = self._archive.keep(*unwritten)
        fault = self._archive.fault
        self._alarms.say(
            "archive",
            None if fault is None else Sentence(f"presses are judged and not archived: {fault}"),
            "warning",
        )
        return evidence

    def _name_map(self, score_map: NDArray[np.float32]) -> tuple[str, bytes]:
        """Hashed once, also where it was scored ahead."""
        if self._map[0] is not score_map:
            self._map = score_map, _name_by_hash(map_bytes(score_map))
        return self._map[1]

    def _reference_now(self, view: View) -> tuple[str, bytes]:
        """Hashed once while it stays the same."""
        if self._reference is None or self._reference[0] is not view:
            stream = io.BytesIO()
            np.save(stream, view, allow_pickle=False)
            self._reference = view, _name_by_hash(stream.getvalue())
        return self._reference[1]


def _name_by_hash(data: bytes) -> tuple[str, bytes]:
    return hashlib.sha256(data).hexdigest(), data
