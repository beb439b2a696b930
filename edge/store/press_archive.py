"""What each verdict was made from, in files: the camera's bytes, the free gel, the score map, the machine.

`objects/` holds bytes by their SHA-256, so that what several presses share is there once. `presses/<press id>.json`
names those of one press. The SHA-256 of that record is in the press's row, which the ledger's chain covers, so nothing
of it can be exchanged without a trace. The newest presses are kept, up to a number and a size.

Nothing here stops an inspection: a press that cannot be archived is recorded without, and `fault` says why.
"""

import hashlib
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from edge.store.ulid import is_ulid

__all__ = ["OBJECTS", "PRESSES", "ArchivedPress", "Digest", "PressArchive", "list_presses"]

OBJECTS: Final = "objects"
PRESSES: Final = "presses"
_DIGEST: Final = re.compile(rb"\b[0-9a-f]{64}\b")

Digest = str
"""SHA-256 in hexadecimal digits."""


class ArchivedPress(BaseModel):
    """What one verdict was made from."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    version: Literal[1] = 1
    press_id: str
    time_ns: int
    station: str
    """The place as site/line/station."""
    serial: str
    part: str
    position: str | None
    bundle_id: Digest
    revision: int | None
    threads: int = Field(ge=1)
    machine: Digest
    """JSON, see `edge.model.machine`."""
    frame: Digest
    """The camera's bytes."""
    touch: tuple[float, float, float]
    """Area and centroid, as `edge.core.contact.mask.Touch`."""
    reference: Digest | None
    """The free gel, .npy float32 (h, w, 3)."""
    verdict: str
    reason: str | None
    error: str | None
    """Reason and error, as published."""
    score: float | None
    threshold: float | None
    score_map: Digest | None
    """Raw bytes, float32 little-endian of `map_shape`, row by row."""
    map_shape: tuple[int, int] | None
    asked_up_to: float | None = None
    """The bound, for a press after which a second one was asked for."""
    first_score: float | None = None
    """The score of the first press, for a second one."""
    masked: Digest | None = None
    """Places that were not judged, under scars or beyond the part, one bit each, row by row."""
    is_too_blind: bool = False
    """More lay under scars than was accepted, so a pass became unsure."""

    @property
    def objects(self) -> tuple[Digest, ...]:
        """Everything that it needs."""
        named = (self.frame, self.reference, self.score_map, self.machine, self.masked)
        return tuple(digest for digest in named if digest)

    def encode(self) -> bytes:
        """The record's file."""
        return self.model_dump_json().encode()


class PressArchive:
    """An archive to write. One thread uses it.

    most_presses, most_bytes: kept, at least one press. why_not: why the disk must not be filled further, or
    None. fault: why the last press was not archived; None where it was.
    """

    def __init__(
        self,
        folder: Path,
        most_presses: int,
        most_bytes: int,
        why_not: Callable[[], str | None] = lambda: None,
    ) -> None:
        self.fault: str | None = None
        self._folder = folder
        self._most_presses, self._most_bytes = most_presses, most_bytes
        self._why_not = why_not
        self._presses: dict[str, tuple[Digest, ...]] = {}
        self._uses: Counter[Digest] = Counter()
        self._sizes: dict[Digest, int] = {}
        self._is_open = False

    def keep(self, press: ArchivedPress, objects: Mapping[Digest, bytes]) -> bytes | None:
        """Write the record and its objects, and remove the oldest ones beyond the limits; returns the SHA-256 of the
        record, None where it could not be written. Never raises for a disk."""
        self.fault = self._why_not()
        if self.fault is None:
            try:
                return self._write_press(press, objects)
            except OSError as error:
                self.fault = f"{self._folder} cannot be written: {error.strerror or error}"
        return None

    def _write_press(self, press: ArchivedPress, objects: Mapping[Digest, bytes]) -> bytes:
        if not self._is_open:
            self._open()
        for digest, data in objects.items():
            if digest not in self._sizes:
                _write(self._folder / OBJECTS / digest, data)
                self._sizes[digest] = len(data)
        record = press.encode()
        _write(self._folder / PRESSES / f"{press.press_id}.json", record)
        self._add(press.press_id, press.objects)
        while len(self._presses) > 1 and self._is_over():
            self._remove_oldest()
        return hashlib.sha256(record).digest()

    def _is_over(self) -> bool:
        return len(self._presses) > self._most_presses or sum(self._sizes.values()) > self._most_bytes

    def _open(self) -> None:
        """Read what is there, and remove objects without a press: a killed process left them."""
        for name in (OBJECTS, PRESSES):
            (self._folder / name).mkdir(parents=True, exist_ok=True)
        for press_id, objects in _records(self._folder):
            self._add(press_id, objects)
        for file in list((self._folder / OBJECTS).iterdir()):
            if file.name in self._uses:
                self._sizes[file.name] = file.stat().st_size
            else:
                file.unlink()
        self._is_open = True

    def _add(self, press_id: str, objects: tuple[Digest, ...]) -> None:
        if press_id not in self._presses:
            self._presses[press_id] = objects
            self._uses.update(objects)

    def _remove_oldest(self) -> None:
        """The record first: objects without one are removed at the next start at the latest."""
        press_id = next(iter(self._presses))
        (self._folder / PRESSES / f"{press_id}.json").unlink(missing_ok=True)
        self._uses.subtract(self._presses.pop(press_id))
        for digest in [digest for digest, uses in self._uses.items() if uses == 0]:
            (self._folder / OBJECTS / digest).unlink(missing_ok=True)
            del self._uses[digest]
            self._sizes.pop(digest, None)


def list_presses(folder: Path) -> list[str]:
    """List the presses whose record is there, oldest first."""
    try:
        names = [entry.name for entry in os.scandir(folder / PRESSES) if entry.is_file()]
    except OSError:
        return []
    return sorted(name[:-5] for name in names if name.endswith(".json") and is_ulid(name[:-5]))


def _records(folder: Path) -> Iterator[tuple[str, tuple[Digest, ...]]]:
    """Press ids and their objects: every digest in the record, so that one of a newer version keeps its objects."""
    for press_id in list_presses(folder):
        record = (folder / PRESSES / f"{press_id}.json").read_bytes()
        yield press_id, tuple(digest.decode() for digest in _DIGEST.findall(record))


def _write(path: Path, data: bytes) -> None:
    """Complete or not at all."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
