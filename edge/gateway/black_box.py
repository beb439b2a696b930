"""What each verdict was made from goes into the archive, so that it can be made again."""

import hashlib
import io
from typing import Final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import Press
from edge.gateway.inspector import Inspector
from edge.model.machine import fingerprint, fingerprint_bytes
from edge.store.press_archive import ArchivedPress, PressArchive
from edge.store.press_store import PressRecord

__all__ = ["BlackBox", "map_bytes", "mask_bytes", "read_mask"]

MAP_DTYPE: Final = np.dtype("<f4")


class BlackBox:
    """Keeps judged presses. station: site/line/station. Used by the loop alone."""

    def __init__(self, archive: PressArchive, station: str, threads: int) -> None:
        self._archive = archive
        self._station = station
        self._threads = threads
        self._machine: tuple[str, bytes] | None = None
        self._reference: tuple[View, tuple[str, bytes]] | None = None

    @property
    def fault(self) -> str | None:
        """Why the last press was not archived; None where it was."""
        return self._archive.fault

    def keep(self, press: PressRecord, inspection: Press, inspector: Inspector) -> bytes | None:
        """The SHA-256 of what was kept of a press; None for one without a judged frame, and where it cannot be kept."""
        judged, verdict = inspection.judged, inspection.verdict
        rejection = verdict.rejection if verdict else None
        if judged is None or not self._archive.is_on or inspector.fault is not None or _is_late(rejection):
            return None
        frame, machine = _named(judged.frame.payload), self._machine_now()
        reference = None if judged.reference is None else self._reference_now(judged.reference)
        score_map = None if inspection.score_map is None else _named(map_bytes(inspection.score_map))
        scars = inspection.scars
        masked = None if scars is None or scars.masked is None else _named(mask_bytes(scars.masked))
        manifest = inspector.bundle.manifest
        record = ArchivedPress(
            press_id=press.press_id,
            time_ns=press.time_ns,
            station=self._station,
            serial=press.serial,
            part=press.part,
            position=press.position,
            bundle_id=inspector.bundle.digest,
            revision=manifest.revision,
            threads=self._threads,
            machine=machine[0],
            frame=frame[0],
            touch=(judged.touch.area, judged.touch.x, judged.touch.y),
            reference=reference[0] if reference else None,
            verdict=press.verdict,
            reason=f"{rejection.reason.value}: {rejection.text}" if rejection else None,
            error=inspection.error,
            score=press.score,
            threshold=press.threshold,
            score_map=score_map[0] if score_map else None,
            asked_up_to=inspection.again.bound if inspection.again else None,
            first_score=inspection.again.first_score if inspection.again else None,
            map_shape=None if inspection.score_map is None else _shape(inspection.score_map),
            masked=masked[0] if masked else None,
            is_too_blind=scars is not None and scars.is_too_blind,
        )
        kept = (frame, machine, reference, score_map, masked)
        return self._archive.keep(record, dict(one for one in kept if one is not None))

    def _machine_now(self) -> tuple[str, bytes]:
        if self._machine is None:
            self._machine = _named(fingerprint_bytes(fingerprint(self._threads)))
        return self._machine

    def _reference_now(self, view: View) -> tuple[str, bytes]:
        """Hashed once while it stays the same."""
        if self._reference is None or self._reference[0] is not view:
            stream = io.BytesIO()
            np.save(stream, view, allow_pickle=False)
            self._reference = view, _named(stream.getvalue())
        return self._reference[1]


def map_bytes(score_map: NDArray[np.float32]) -> bytes:
    """A score map as it is archived: float32 little-endian, row by row."""
    return np.ascontiguousarray(score_map, MAP_DTYPE).tobytes()


def mask_bytes(masked: NDArray[np.bool_]) -> bytes:
    """Places as they are archived: one bit each, row by row."""
    return np.packbits(masked).tobytes()


def read_mask(data: bytes, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The same again, bool of this shape. Errors: ValueError for another number of bytes."""
    bits = np.unpackbits(np.frombuffer(data, np.uint8), count=shape[0] * shape[1])
    return bits.reshape(shape).astype(np.bool_)


def _is_late(rejection: Rejection | None) -> bool:
    """A frame that was too old then is not made again."""
    return rejection is not None and rejection.reason is Reason.STALE


def _named(data: bytes) -> tuple[str, bytes]:
    return hashlib.sha256(data).hexdigest(), data


def _shape(score_map: NDArray[np.float32]) -> tuple[int, int]:
    h, w = score_map.shape
    return h, w
