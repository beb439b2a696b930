"""What each verdict was made from, in files: the camera's bytes, the free gel, the score map, the machine.

`objects/` holds bytes by their SHA-256, so that what several presses share is there once. `presses/<press id>.json`
names those of one press. The SHA-256 of that record is in the press's row, which the ledger's chain covers, so nothing
of it can be exchanged without a trace. The newest presses are kept, up to a number and a size; of those that people
spoke of older ones too, up to half of both.

Nothing here stops an inspection: a press that cannot be archived is recorded without, and `fault` says why.
`ArchiveFolder` reads an archive, and says what is gone or damaged.
"""

import hashlib
import io
import logging
import os
import re
import sqlite3
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from edge.core.errors import ArchiveError
from edge.store.ulid import is_ulid

__all__ = [
    "OBJECTS",
    "PRESSES",
    "ArchiveFolder",
    "ArchivedPress",
    "Digest",
    "PressArchive",
    "list_presses",
    "map_bytes",
    "mask_bytes",
    "read_archived",
]

log = logging.getLogger(__name__)

OBJECTS: Final = "objects"
PRESSES: Final = "presses"
_DIGEST: Final = re.compile(rb"\b[0-9a-f]{64}\b")
_MAP: Final = np.dtype("<f4")

_Colour = tuple[float, float, float]
Digest = str
"""SHA-256 in hexadecimal digits."""


class ArchivedPress(BaseModel, frozen=True, extra="forbid", strict=True, allow_inf_nan=False):
    """What one verdict was made from."""

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
    """JSON, see `edge.model.session`."""
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
    own_score: float | None = None
    """Its own, for a second one whose `score` is what both presses showed at one place."""
    masked: Digest | None = None
    """Places that were not judged, under scars or beyond the part, one bit each, row by row."""
    light: tuple[_Colour, _Colour] | tuple[_Colour, _Colour, str] | None = None
    """Gain and offset of red, green and blue, where it was brought to the light of the fit, and the shading of a new
    gel, as `FollowedLight` has them."""
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

    def sha256(self) -> bytes:
        """Hash the record's file, as the press's row names it."""
        return hashlib.sha256(self.encode()).digest()


def map_bytes(score_map: NDArray[np.float32]) -> bytes:
    """A score map as it is archived: float32 little-endian, row by row."""
    return np.ascontiguousarray(score_map, _MAP).tobytes()


def mask_bytes(masked: NDArray[np.bool_]) -> bytes:
    """Places as they are archived: one bit each, row by row."""
    return np.packbits(masked).tobytes()


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
        self.most_presses, self._most_bytes = most_presses, most_bytes
        self.why_not = why_not
        # Oldest first. What is asked of each press is counted as it comes and goes: a walk over 200,000 took 0.1 s.
        self._presses: OrderedDict[str, tuple[Digest, ...]] = OrderedDict()
        # Without the newest, and those that people spoke of.
        self._others: OrderedDict[str, None] = OrderedDict()
        self._spoken_of: set[str] = set()
        self._uses: Counter[Digest] = Counter()
        self._held: Counter[Digest] = Counter()  # of those that people spoke of, without the newest
        self._sizes: dict[Digest, int] = {}
        self._bytes = self._held_bytes = 0
        self._unread: set[Digest] = set()  # of an earlier process
        self._is_open = False
        self._number: Mapping[str, int] = {}

    def open(self, made: Sequence[str] = ()) -> None:
        """Read an archive that is there already, so that the first press need not wait for it. Never raises.

        made: ids of its presses as they were made, oldest first, for ids do not tell that where the clock was set back;
        others are older.
        """
        self._number = {press_id: number for number, press_id in enumerate(made)}
        try:
            if not self._is_open and self._folder.is_dir():
                self._open()
        except OSError as error:
            log.warning(
                "the archive %s is read with the first press: %s", self._folder, error.strerror or error
            )

    def keep_longer(self, press_ids: Iterable[str]) -> None:
        """Keep these when others of their age are removed, for people spoke of them: the oldest of them go first where
        they take more than half of the presses, or of the bytes, that are kept."""
        for press_id in press_ids:
            self._spoken_of.add(press_id)
            if press_id in self._others:
                del self._others[press_id]
                self._hold(press_id)

    def keep(self, press: ArchivedPress, objects: Mapping[Digest, bytes]) -> bytes | None:
        """Write the record and its objects, and remove the oldest ones beyond the limits; returns the SHA-256 of the
        record, None where it could not be written. Never raises for a disk."""
        self.fault = self.why_not()
        if self.fault is None:
            try:
                return self._write_press(press, objects)
            except OSError as error:
                self.fault = f"{self._folder} cannot be written: {error.strerror or error}"
        return None

    def _write_press(self, press: ArchivedPress, objects: Mapping[Digest, bytes]) -> bytes:
        if not self._is_open:
            self._open()
        self._make_folders()
        for digest, data in objects.items():
            path = self._folder / OBJECTS / digest
            # Somebody may have removed what later presses share with earlier ones, or a power cut damaged it.
            if not (
                _holds(path, data) if digest in self._unread else digest in self._sizes and path.exists()
            ):
                _write(path, data)
            self._unread.discard(digest)
            added = len(data) - self._sizes.get(digest, 0)
            self._sizes[digest] = len(data)
            self._bytes += added
            self._held_bytes += added if digest in self._held else 0
        record = press.encode()
        _write(self._folder / PRESSES / f"{press.press_id}.json", record)
        self._add(press.press_id, press.objects)
        while len(self._presses) > 1 and (
            len(self._presses) > self.most_presses or self._bytes > self._most_bytes
        ):
            self._remove_oldest()
        return hashlib.sha256(record).digest()

    def _open(self) -> None:
        """Read what is there, and remove objects without a press: a killed process left them."""
        self._make_folders()
        self._sizes = {file.name: file.stat().st_size for file in (self._folder / OBJECTS).iterdir()}
        for press_id, objects in sorted(_records(self._folder), key=lambda one: self._number.get(one[0], -1)):
            self._add(press_id, objects)
        for digest in self._sizes.keys() - self._uses.keys():
            (self._folder / OBJECTS / digest).unlink()
            del self._sizes[digest]
        self._bytes = sum(self._sizes.values())
        self._unread = set(self._sizes)
        self._is_open = True

    def _make_folders(self) -> None:
        for name in (OBJECTS, PRESSES):
            (self._folder / name).mkdir(parents=True, exist_ok=True)

    def _add(self, press_id: str, objects: tuple[Digest, ...]) -> None:
        if press_id in self._presses:
            return
        if self._presses:
            before = next(reversed(self._presses))
            if before in self._spoken_of:
                self._hold(before)
            else:
                self._others[before] = None
        self._presses[press_id] = objects
        self._uses.update(objects)

    def _hold(self, press_id: str) -> None:
        for digest in self._presses[press_id]:
            self._held_bytes += 0 if digest in self._held else self._sizes.get(digest, 0)
            self._held[digest] += 1

    def _remove_oldest(self) -> None:
        """The record first: objects without one are removed at the next start at the latest."""
        spoken_of = len(self._presses) - 1 - len(self._others)
        is_too_much = 2 * spoken_of > self.most_presses or 2 * self._held_bytes > self._most_bytes
        press_id = next(iter(self._presses if is_too_much or not self._others else self._others))
        (self._folder / PRESSES / f"{press_id}.json").unlink(missing_ok=True)
        objects = self._presses.pop(press_id)
        if press_id in self._others:
            del self._others[press_id]
        else:
            self._spoken_of.discard(press_id)
            for digest in _take(self._held, objects):
                self._held_bytes -= self._sizes.get(digest, 0)
        for digest in _take(self._uses, objects):
            (self._folder / OBJECTS / digest).unlink(missing_ok=True)
            self._bytes -= self._sizes.pop(digest, 0)


def _take(uses: Counter[Digest], objects: Sequence[Digest]) -> list[Digest]:
    """Take uses away; return the objects that have none left."""
    uses.subtract(objects)
    unused = [digest for digest in dict.fromkeys(objects) if uses[digest] == 0]
    for digest in unused:
        del uses[digest]
    return unused


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


def _holds(path: Path, data: bytes) -> bool:
    try:
        return path.read_bytes() == data
    except OSError:
        return False


def _write(path: Path, data: bytes) -> None:
    """Complete or not at all."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def read_archived(connection: sqlite3.Connection, most: int) -> list[str]:
    """The ids of the newest presses that were archived, as they were made, oldest first; a history may be long."""
    query = "SELECT press_id FROM presses WHERE evidence IS NOT NULL ORDER BY number DESC LIMIT ?"
    return [press_id for (press_id,) in connection.execute(query, (most,))][::-1]


class ArchiveFolder:
    """An archive to read. Errors of every method: ArchiveError, which says what is gone or damaged."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def press(self, press_id: str, evidence: bytes | None) -> ArchivedPress:
        """The record of a press. evidence: its SHA-256 by the ledger."""
        if evidence is None:
            raise ArchiveError(
                f"press {press_id} was never archived: it has no judged frame, or the archive was off or without room"
            )
        path = self.folder / PRESSES / f"{press_id}.json"
        data = _read(path, f"press {press_id}")
        if hashlib.sha256(data).digest() != evidence:
            raise ArchiveError(
                f"{path} is not what the ledger says of press {press_id}: it was changed, or is of another database; "
                "take it from a backup"
            )
        try:
            return ArchivedPress.model_validate_json(data)
        except ValidationError as error:
            raise ArchiveError(
                f"{path} cannot be read by this version ({error.errors()[0]['msg']}); use the version that wrote it"
            ) from error

    def has_all(self, press: ArchivedPress) -> bool:
        """Tell whether every file that a press needs is there, without reading them."""
        return all((self.folder / OBJECTS / digest).is_file() for digest in press.objects)

    def read_map(self, press: ArchivedPress) -> NDArray[np.float32]:
        """The score map of a press, float32 (h, w)."""
        data, shape = self._read_of(press, press.score_map, "score map")
        return np.frombuffer(data, _MAP).reshape(shape)

    def read_masked(self, press: ArchivedPress) -> NDArray[np.bool_]:
        """The places of a press that were not judged, bool (h, w) of its score map."""
        data, shape = self._read_of(press, press.masked, "mask of places that were not judged")
        return np.unpackbits(np.frombuffer(data, np.uint8), count=shape[0] * shape[1]).reshape(shape) > 0

    def read_reference(self, press: ArchivedPress) -> NDArray[np.float32] | None:
        """The free gel that a press was compared with, float32 (120, 160, 3); None where none was learnt."""
        if press.reference is None:
            return None
        data = self.read(press.reference, f"the free gel of press {press.press_id}")
        return np.asarray(np.load(io.BytesIO(data), allow_pickle=False), np.float32)

    def _read_of(
        self, press: ArchivedPress, digest: Digest | None, name: str
    ) -> tuple[bytes, tuple[int, int]]:
        if digest is None or press.map_shape is None:
            raise ArchiveError(f"press {press.press_id} has no {name}: it was not scored")
        return self.read(digest, f"the {name} of press {press.press_id}"), press.map_shape

    def read(self, digest: Digest, what: str) -> bytes:
        """The bytes of this SHA-256. what: in words, for errors."""
        path = self.folder / OBJECTS / digest
        data = _read(path, what)
        if hashlib.sha256(data).hexdigest() != digest:
            raise ArchiveError(
                f"{what} is damaged: {path} has another SHA-256 than its name; take it from a backup"
            )
        return data


def _read(path: Path, what: str) -> bytes:
    if path.is_fifo():
        raise ArchiveError(f"{what} cannot be read: {path} is a named pipe; take the file from a backup")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ArchiveError(
            f"{what} is gone: {path} is not there; only the newest presses are kept ([archive]), without one just "
            "before a crash; older ones are in backups of the folder, which `gelgate station replay --archive` reads"
        ) from None
    except OSError as error:
        raise ArchiveError(f"{what} cannot be read: {path}: {error.strerror}; check its rights") from error
