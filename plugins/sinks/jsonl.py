"""Appends messages to a file: one JSON line each, and pictures as files of their own.

A line is `{"topic": ..., "retain": ..., "payload": {...}}`, with a text for plain text, or
`"file": "heatmap/<press id>.jpg"` for a picture. Both are on the disk before `send` returns. Beyond `keep_mb` the
oldest are removed: `messages.jsonl` becomes `messages.1.jsonl` when it has a quarter of the room, and the oldest
pictures of messages go; other files in the folder stay. What it does not do: it has no subscribers and takes no
commands. A retained topic is an ordinary line, and the last one counts; what changes at every moment (`contact`,
retained at QoS 0) is not written.
"""

import errno
import fcntl
import json
import os
import threading
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Final

from pydantic import BaseModel, Field

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.imaging.image_bytes import kind
from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station

__all__ = ["Jsonl", "JsonlOptions", "JsonlSink", "plugin"]

# First levels of the topics that have pictures of presses, and so folders of many.
PICTURES: Final = ("heatmap", "scoremap", "overview")

_BLOCK_BYTES: Final = 4096


class JsonlOptions(BaseModel, extra="forbid", frozen=True):
    """Options of the file sink."""

    folder: Path = Field(description="the folder of `messages.jsonl` and the pictures, made at first use")

    keep_mb: float = Field(
        default=1000,
        ge=1,
        le=1_000_000,
        description="room for all of it; the oldest lines and pictures go first",
    )

    def identity(self) -> str:
        """The folder."""
        return str(self.folder)

    def warnings(self) -> list[str]:
        """Say that nothing can be written in the folder, or that it cannot be made."""
        above = next((path for path in (self.folder, *self.folder.parents) if path.exists()), self.folder)
        if above.is_dir() and os.access(above, os.W_OK):
            return []
        return [f"{self.folder} cannot be written now: {above} is no folder to write in; results will wait"]


class JsonlSink:
    """A folder of messages. Topics are relative to the station's root, which each line names."""

    def __init__(self, folder: Path, root: str, keep_bytes: int = 1_000_000_000) -> None:
        self._folder = folder
        self._keep_bytes = keep_bytes
        self._unchecked_bytes = (
            keep_bytes  # pictures written since their room was last compared; at first all
        )
        self._picture_folders = {folder / kind for kind in PICTURES}
        self._root = root
        self._lock = threading.Lock()
        self.faults: tuple[str, ...] = ()
        """Why nothing can be written. The alarm `disk` is of the database's disk alone."""

    def send(self, message: Message) -> None:
        """Append and flush to disk. Errors: SinkUnavailable when the disk refuses, SinkRejected for invalid JSON."""
        if message.retain and message.qos == 0:
            return
        line: dict[str, object] = {"root": self._root, "topic": message.topic, "retain": message.retain}
        try:
            with self._lock:
                self._folder.mkdir(parents=True, exist_ok=True)
                if message.content_type == "text/plain":
                    line["payload"] = message.payload.decode()
                elif message.content_type == "application/json":
                    line["payload"] = json.loads(message.payload) if message.payload else None
                else:
                    line["file"] = self._picture(message) if message.payload else None
                self._append(line)
            self.faults = ()
        except ValueError as error:
            raise SinkRejected(
                f"the message on {message.topic} is not JSON ({error}); it was not written"
            ) from error
        except OSError as error:
            why = f"folder {self._folder} cannot be written: {error.strerror or error}; free space or change its rights"
            self.faults = (why,)
            raise SinkUnavailable(why) from error

    def close(self) -> None:
        """Nothing stays open between messages."""

    def _picture(self, message: Message) -> str:
        name = f"{message.topic}.{kind(message.payload) or 'bin'}"
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            file.write(message.payload)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        self._picture_folders.add(path.parent)
        self._limit_pictures(len(message.payload))
        return name

    def _limit_pictures(self, added_bytes: int) -> None:
        """Pictures have half of the room. Their folders are read again after each hundredth of the room only."""
        self._unchecked_bytes += added_bytes
        if self._unchecked_bytes < self._keep_bytes // 100:
            return
        self._unchecked_bytes = 0
        pictures = [
            (path, path.stat())
            for folder in self._picture_folders
            for suffix in ("jpg", "png")
            for path in folder.glob(f"*.{suffix}")
        ]
        excess = sum(stat.st_size for _, stat in pictures) - self._keep_bytes // 2
        for path, stat in sorted(pictures, key=lambda one: one[1].st_mtime_ns)[:-1]:
            if excess <= 0:
                return
            path.unlink(missing_ok=True)
            excess -= stat.st_size

    def _append(self, line: dict[str, object]) -> None:
        data = json.dumps(line, separators=(",", ":"), ensure_ascii=False).encode() + b"\n"
        path = self._folder / "messages.jsonl"
        if path.exists() and path.stat().st_size + len(data) > self._keep_bytes // 4:
            path.replace(self._folder / "messages.1.jsonl")
        with path.open("a+b", buffering=0) as file:
            with suppress(OSError):  # where a file system has no locks, one station alone writes here
                fcntl.flock(file, fcntl.LOCK_EX)
            start = _find_end_of_lines(file)
            file.truncate(start)  # what a power cut has left of a line, which is sent again
            try:
                if file.write(data) != len(data):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())
            except OSError:
                file.truncate(start)  # an incomplete line would damage the next one too
                raise


def _find_end_of_lines(file: FileIO) -> int:
    """Return where the last complete line ends."""
    end = file.seek(0, os.SEEK_END)
    while end:
        start = max(0, end - _BLOCK_BYTES)
        file.seek(start)
        if (position := file.read(end - start).rfind(b"\n")) >= 0:
            return start + position + 1
        end = start
    return 0


class Jsonl(SinkPlugin[JsonlOptions]):
    """The plugin."""

    Options = JsonlOptions

    def open(self, options: JsonlOptions, station: Station) -> JsonlSink:
        """The folder's sink. Birth messages are not written: the log has the same facts."""
        return JsonlSink(options.folder, station.root, round(options.keep_mb * 1e6))


plugin = Jsonl()
