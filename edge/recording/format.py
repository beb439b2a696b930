"""Recordings: a folder of camera frames and an index, written by capture and simulation, played by virtual devices.

    recording.toml    `version` first, then who the sensor was and its video mode
    index.jsonl       one line a frame: sequence, time_ns, file, and `label` (any object, kept as it is)
    frames/*.jpg|png  the camera's bytes, untouched

A frame's index line is written after its file is complete, so a recording cut short by a kill or a full disk is
readable up to its last complete line. It is not synced per frame: after a power cut the last frames may be missing.
"""

import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Self

from pydantic import TypeAdapter, ValidationError

from edge.core.errors import PressesMissed, RecordingError, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import kind
from edge.core.ports import DeviceIdentity
from edge.core.printable import toml_string

__all__ = [
    "DELIVERED_SHARE",
    "FRAMES",
    "HEADER",
    "Recording",
    "RecordingHeader",
    "RecordingWriter",
    "list_some",
]

VERSION = 1
# Independent reports agree on 18.75 fps delivered where 25 are advertised (firmware_notes/gelsight_mini.md).
DELIVERED_SHARE = 0.75
HEADER, FRAMES, _INDEX = "recording.toml", "frames", "index.jsonl"
# An error lists at most this many entries and counts the others.
_LISTED = 20


@dataclass(frozen=True)
class RecordingHeader:
    """The recorded sensor. `mode` is (width, height) of the frames. `nominal_fps` is what the camera advertises; how
    fast the frames came is in their times. `profile` names the sensor profile that fits them."""

    product: str
    serial: str
    mode: tuple[int, int]
    nominal_fps: float
    profile: str = ""

    def __post_init__(self) -> None:
        if min(self.mode) < 1:
            raise ValueError(f"a video mode is (width, height), both positive, found {self.mode}")
        if not 0 < self.nominal_fps < 1000:
            raise ValueError(f"nominal_fps is between 0 and 1000, found {self.nominal_fps}")

    @property
    def identity(self) -> DeviceIdentity:
        return DeviceIdentity(self.product, self.serial, self.mode, self.nominal_fps)


@dataclass(frozen=True)
class RecordedFrame:
    """One frame and its label. `frame.timestamp_ns` is the recorder's clock: only differences count."""

    frame: CameraFrame
    label: Mapping[str, object] | None = None


@dataclass(frozen=True)
class _Entry:
    """One line of the index."""

    sequence: int
    time_ns: int
    file: str
    label: Mapping[str, object] | None = None

    def __post_init__(self) -> None:
        if Path(self.file).is_absolute() or ".." in Path(self.file).parts:
            raise ValueError(f"file {self.file!r} leads out of the recording")


_ENTRY = TypeAdapter(_Entry)
_HEADER_TABLE = TypeAdapter(RecordingHeader)


class Recording:
    """A checked recording that can be played. Frames are read from disk at access."""

    def __init__(
        self, folder: Path, header: RecordingHeader, entries: tuple[_Entry, ...], *, is_cut: bool
    ) -> None:
        self.folder = folder
        self.header = header
        self.is_cut = is_cut
        self._entries = entries

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Read and check a recording. Errors: RecordingError, with every missing file in one report."""
        header = _read_header(folder)
        entries, is_cut = _read_index(folder / _INDEX)
        missing = [entry.file for entry in entries if not (folder / entry.file).is_file()]
        if missing:
            raise RecordingError(
                f"recording {folder} lacks {len(missing)} of its {len(entries)} frame files: {list_some(missing)}"
            )
        return cls(folder, header, entries, is_cut=is_cut)

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, position: int) -> RecordedFrame:
        entry = self._entries[position]
        try:
            payload = (self.folder / entry.file).read_bytes()
        except OSError as error:
            raise RecordingError(
                f"recording {self.folder}: frame {entry.file} cannot be read: {error.strerror}"
            ) from error
        return RecordedFrame(CameraFrame(payload, entry.time_ns, entry.sequence), entry.label)

    def __iter__(self) -> Iterator[RecordedFrame]:
        return (self[position] for position in range(len(self)))

    def labels(self) -> list[Mapping[str, object] | None]:
        """The label of every frame, without reading any frame."""
        return [entry.label for entry in self._entries]

    def presses(self) -> int | None:
        """The number of presses in its labels; None without such labels."""
        numbers = {label.get("press") for label in self.labels() if label is not None}
        return len([number for number in numbers if isinstance(number, int)]) or None

    def check_presses(self, seen: int, frames: int, dropped: int) -> None:
        """Compare the presses that a run saw until the end with the labels. Errors: PressesMissed where they differ.

        Without labels: where frames were dropped, or no press was seen. frames, dropped: delivered, and of these not
        processed.
        """
        held = self.presses()
        if held == seen or (held is None and seen and not dropped):
            return
        counts = (
            f"its number of presses is not known and the run saw {seen}"
            if held is None
            else f"it holds {held} presses and the run saw {seen}"
        )
        if dropped:
            why = (
                f"{dropped} of its {frames} frames were dropped because they were not processed in time; play it with "
                "pace = 0"
            )
        elif seen:
            why = "no frame was dropped; play it with pace 0 or 1, and `gelgate run -v` shows contact in each frame"
        else:
            why = (
                "no frame was dropped; a press counts after two seconds of the free gel, and `gelgate run -v` shows "
                "contact in each frame"
            )
        cut = "; its index ends in the middle of a line, so the end of it is lost" if self.is_cut else ""
        raise PressesMissed(f"recording {self.folder}: {counts}; {why}{cut}")

    def times_ns(self) -> list[int]:
        """The time of every frame, without reading any frame."""
        return [entry.time_ns for entry in self._entries]

    def gaps_ns(self) -> list[int]:
        """The time from the frame before to each frame. That of the first one, when it is played again, is usual."""
        gaps = [later - earlier for earlier, later in pairwise(self.times_ns())]
        usual = round(median(gaps)) if gaps else 0
        return [usual or round(1e9 / self.header.nominal_fps), *gaps]


class RecordingWriter:
    """Writes one recording, frame by frame; a context manager. See `resume` for an interrupted one.

    Errors: RecordingError when the folder already holds something, StoreError when the disk refuses a frame; earlier
    frames remain a valid recording.
    """

    def __init__(self, folder: Path, header: RecordingHeader) -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise RecordingError(
                f"{folder} is not an empty folder; a recording is never written over something else"
            )
        self._start(folder, header, keep=0, index_end=0)

    @classmethod
    def resume(cls, folder: Path, header: RecordingHeader, *, keep: int) -> Self:
        """Continue an interrupted recording: its first `keep` frames stay, every later frame and line is removed.

        With `keep` 0 the folder may be missing, or hold other files, which stay. Errors: RecordingError, with nothing
        changed, for fewer complete lines or another header; StoreError when the disk refuses.
        """
        writer = cls.__new__(cls)
        writer._start(folder, header, keep, _end_of_kept(folder, header, keep) if keep else 0)
        return writer

    def _start(self, folder: Path, header: RecordingHeader, keep: int, index_end: int) -> None:
        self._folder = folder
        self._count = keep
        try:
            (folder / FRAMES).mkdir(parents=True, exist_ok=True)
            if keep == 0:
                (folder / HEADER).write_text(_header_text(header), encoding="utf-8")
            self._index = (folder / _INDEX).open("ab", buffering=0)
            # Lines are removed before their frames, so a kill in between leaves no line without its frame.
            self._index.truncate(index_end)
            for path in (folder / FRAMES).glob("[0-9]*.*"):
                if path.stem.isdecimal() and int(path.stem) >= keep:
                    path.unlink()
        except OSError as error:
            raise StoreError(
                f"recording {folder} cannot be started: {error.strerror}; choose another folder"
            ) from error

    def add(self, payload: bytes, time_ns: int, label: Mapping[str, object] | None = None) -> None:
        """Append one frame: its file first, then its line in the index."""
        name = f"{FRAMES}/{self._count:06d}.{kind(payload) or 'bin'}"
        entry: dict[str, object] = {"sequence": self._count, "time_ns": time_ns, "file": name}
        if label is not None:
            entry["label"] = dict(label)
        line = (json.dumps(entry, ensure_ascii=False) + "\n").encode()
        try:
            (self._folder / name).write_bytes(payload)
            self._append(line)
        except OSError as error:
            raise StoreError(
                f"recording {self._folder} stops after {self._count} frames: {error.strerror}; "
                "those are kept, free some space"
            ) from error
        self._count += 1

    def _append(self, line: bytes) -> None:
        """Append one complete line or none: when the disk fills up within a line, the index stays unchanged."""
        before = self._index.seek(0, os.SEEK_END)
        try:
            written = self._index.write(line)
            if written != len(line):
                raise OSError(28, "No space left on device")
        except OSError:
            self._index.truncate(before)
            raise

    def __len__(self) -> int:
        return self._count

    def close(self) -> None:
        """Finish; harmless when repeated."""
        self._index.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _header_text(header: RecordingHeader) -> str:
    return (
        f"version = {VERSION}\n"
        f"product = {toml_string(header.product)}\n"
        f"serial = {toml_string(header.serial)}\n"
        f"width = {header.mode[0]}\n"
        f"height = {header.mode[1]}\n"
        f"nominal_fps = {float(header.nominal_fps)!r}\n"
        f"profile = {toml_string(header.profile)}\n"
    )


def _read_header(folder: Path) -> RecordingHeader:
    path = folder / HEADER
    if folder.is_file():
        raise RecordingError(
            f"{folder} is a file, not the folder of a recording; a film becomes one with "
            f"`gelgate record FOLDER --from-video {folder.name}`"
        )
    if path.is_fifo() or (folder / _INDEX).is_fifo():
        raise RecordingError(f"recording {folder} has a named pipe in place of {HEADER} or {_INDEX}")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        fault = f"is not a recording: it has no {HEADER}" if folder.is_dir() else "does not exist"
        raise RecordingError(
            f"recording {folder} {fault}; correct the path, or make one with `gelgate record`"
        ) from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecordingError(f"{path} cannot be read: {error}") from error
    version = table.get("version")
    if not isinstance(version, int) or version < 1:
        raise RecordingError(f"{path} has version {version!r}; expected {VERSION}")
    if version > VERSION:
        raise RecordingError(
            f"{path} is of format version {version}; this program reads up to {VERSION}, install a newer gelgate"
        )
    try:
        mode = (table.get("width"), table.get("height"))
        return _HEADER_TABLE.validate_json(json.dumps({**table, "mode": mode}, default=str), strict=True)
    except ValidationError as error:
        raise RecordingError(
            f"{path} lacks a field or has a wrong one, where mode is width and height: {_faults(error)}"
        ) from error


def _faults(error: ValidationError) -> str:
    return ", ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors())


def _end_of_kept(folder: Path, header: RecordingHeader, keep: int) -> int:
    """Find where in the index the first `keep` lines end, in bytes."""
    present = _read_header(folder)
    if present != header:
        raise RecordingError(f"recording {folder} is of {present}, not of {header}; choose another folder")
    try:
        lines = (folder / _INDEX).read_bytes().split(b"\n")[:-1]
    except OSError as error:
        raise RecordingError(f"{folder / _INDEX} cannot be read: {error.strerror}") from error
    if len(lines) < keep:
        raise RecordingError(
            f"recording {folder} has {len(lines)} complete frames, expected at least {keep}; "
            "start again in another folder"
        )
    return sum(len(line) + 1 for line in lines[:keep])


def _read_index(path: Path) -> tuple[tuple[_Entry, ...], bool]:
    """The entries, and whether an incomplete last line was left out."""
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise RecordingError(
            f"{path.parent} has no {_INDEX}: it is not a recording, or ended before its first frame"
        ) from error
    *lines, rest = content.split(b"\n")
    entries: list[_Entry] = []
    faults: list[str] = []
    for number, line in enumerate(lines, start=1):
        try:
            entries.append(_ENTRY.validate_json(line, strict=True))
        except ValidationError as error:
            faults.append(f"line {number} ({_faults(error)})")
    if faults:
        raise RecordingError(
            f"{path} has {len(faults)} lines that are not index entries: {list_some(faults)}"
        )
    _check_times(path, entries)
    return tuple(entries), bool(rest)


def _check_times(path: Path, entries: list[_Entry]) -> None:
    backward = [
        f"sequence {later.sequence}"
        for earlier, later in pairwise(entries)
        if later.time_ns < earlier.time_ns or later.sequence <= earlier.sequence
    ]
    if backward:
        raise RecordingError(
            f"{path} goes back in time or sequence at {list_some(backward)}; frames are kept in order"
        )


def list_some(things: list[str]) -> str:
    """List the first twenty, and count the others."""
    more = len(things) - _LISTED
    return ", ".join(things[:_LISTED]) + (f" and {more} more" if more > 0 else "")
