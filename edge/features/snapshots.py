"""Snapshots: the camera's frames around a moment, kept in memory, written as a recording when somebody asks for one.

They are written in the background, so no press waits for a disk.
"""

import logging
import shutil
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final, Self

from pydantic import Field

from edge.background import Background
from edge.core.errors import GelgateError
from edge.core.imaging.frames import CameraFrame
from edge.messaging.command_payloads import CommandArguments
from edge.press_stage import Command, Data, Mounted, PressStage, StageParts
from edge.recording.format import RecordingHeader, RecordingWriter
from edge.store.acts import Act

__all__ = ["KEPT", "RING_BYTES", "Snapshots"]

# Seconds of a snapshot before the request, and after it.
MOST_SNAPSHOT_S: Final = 10
# In memory: 7 s of the sensor's 3280x2464 at 25 frames a second of some 700 kB each.
RING_BYTES: Final = 128_000_000
# On the disk.
KEPT: Final = 20
KEPT_BYTES: Final = 1_000_000_000
# A stream that stops does not hold back what is there.
PATIENCE_S: Final = 2.0
CLOSE_S: Final = 10.0

log = logging.getLogger(__name__)


class SnapshotArguments(CommandArguments):
    """Of `cmd/snapshot`: seconds before and after the request."""

    before_s: float = Field(default=5, ge=0, le=MOST_SNAPSHOT_S)
    after_s: float = Field(default=2, ge=0, le=MOST_SNAPSHOT_S)


@dataclass(frozen=True)
class _Wish:
    """Frames of this time span, by the frames' own clock."""

    folder: Path
    first_ns: int
    last_ns: int
    due_ns: int
    """By the station's; then what is there is written."""


class Snapshots(PressStage):
    """Keeps the newest frames, and writes those of a wish. The loop alone calls it.

    Each snapshot is in the store's table of acts.
    """

    def __init__(self, parts: StageParts) -> None:
        self._folder = parts.config.store.path.with_suffix(".snapshots")
        self._clock, self._store = parts.clock, parts.store
        self._find_sensor, self._find_low_space = parts.find_sensor, parts.find_low_space
        self._ring: deque[CameraFrame] = deque()
        self._bytes = 0
        self._wish: _Wish | None = None
        self._done: Act | None = None
        self.worker: Background[Act] = Background("snapshots", CLOSE_S)

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Snapshots are kept next to the database."""
        return cls(parts)

    def start(self) -> None:
        self.worker.start()

    def take(self, frame: CameraFrame) -> None:
        """Keep the newest frame; the oldest ones leave."""
        if frame.damage is not None:
            return
        if self._ring and frame.timestamp_ns <= self._ring[-1].timestamp_ns:
            return
        self._ring.append(frame)
        self._bytes += len(frame.payload)
        span_ns = 2 * MOST_SNAPSHOT_S * 1e9
        while self._bytes > RING_BYTES or frame.timestamp_ns - self._ring[0].timestamp_ns > span_ns:
            self._bytes -= len(self._ring.popleft().payload)

    def request(self, before_s: float, after_s: float) -> Path:
        """Write the frames from before the newest one to after now; returns the folder of the recording, which is there
        when it is complete. Errors: ValueError while there are no frames, or another one is being made."""
        if (low := self._find_low_space()) is not None:
            raise ValueError(f"no snapshot is written: {low}")
        if not self._ring:
            raise ValueError("no frame has arrived from a sensor yet; try again later")
        if self._wish is not None or self.worker.is_busy:
            raise ValueError("another snapshot is being written; try again in some seconds")
        newest, now = self._ring[-1], datetime.fromtimestamp(self._clock.time_ns() / 1e9, UTC)
        folder = self._folder / f"{now:%Y%m%dT%H%M%S.%fZ}"
        now_ns = self._clock.monotonic_ns()
        # The sensor may have been away for long; a frame that is made on demand has the time of a recording.
        asked_ns = newest.timestamp_ns if newest.is_on_demand else max(newest.timestamp_ns, now_ns)
        first_ns, last_ns = newest.timestamp_ns - round(before_s * 1e9), asked_ns + round(after_s * 1e9)
        due_ns = now_ns + round((after_s + PATIENCE_S) * 1e9)
        self._wish = _Wish(folder, first_ns, last_ns, due_ns)
        return folder

    def _answer(self, arguments: SnapshotArguments) -> Data:
        recording = self.request(arguments.before_s, arguments.after_s)
        return {"recording": str(recording), "is_waiting": True}

    commands = (
        Command(
            "snapshot",
            SnapshotArguments,
            _answer,
            "write the camera's frames around now as a recording below the state folder; `recording` is its folder, "
            f"which is there when it is complete. At most {KEPT} with {KEPT_BYTES / 1e6:g} MB are kept, the oldest go "
            "first",
            "the oldest snapshots",
        ),
    )

    def turn(self, mounted: Mounted | None) -> None:
        """Record the outcome of a wish, and hand over the frames of one when the last frame is there. Errors:
        StoreError; the outcome is then recorded by a later turn."""
        self._done = self._done or self.worker.take()
        if self._done is not None:
            self._store.begin_act(self._done)
            self._done = None
        wish, identity = self._wish, self._find_sensor()
        if (
            wish is not None
            and identity is not None
            and (self._ring[-1].timestamp_ns >= wish.last_ns or self._clock.monotonic_ns() >= wish.due_ns)
        ):
            frames = [one for one in self._ring if wish.first_ns <= one.timestamp_ns <= wish.last_ns]
            header = RecordingHeader(identity.product, identity.serial, identity.mode, identity.nominal_fps)
            self.worker.ask(partial(self._save, wish.folder, frames, header))
            self._wish = None

    def _save(self, folder: Path, frames: Sequence[CameraFrame], header: RecordingHeader) -> Act:
        """Write the frames; returns what becomes of it, for the table of acts."""
        size = sum(len(frame.payload) for frame in frames)
        after = {"recording": str(folder), "frames": len(frames), "bytes": size}
        fault = None
        try:
            self._write(folder, frames, header)
        except (GelgateError, OSError) as error:
            fault = f"snapshot {folder} is not written: {error}"
            log.error("%s", fault)
        return Act(
            self._clock.time_ns(),
            "the gateway",
            "snapshot",
            outcome="done" if fault is None else "failed",
            sentence=fault,
            after=after,
        )

    def close(self) -> None:
        self.worker.close()

    def _write(self, folder: Path, frames: Sequence[CameraFrame], header: RecordingHeader) -> None:
        """Room first; a name without a dot in front is a complete recording. Errors: GelgateError, OSError."""
        if not frames:
            raise GelgateError("no frame came in its time")
        folder.parent.mkdir(exist_ok=True)
        for left in folder.parent.glob(".*"):  # of a process that was killed
            shutil.rmtree(left)
        _make_room(folder.parent, sum(len(frame.payload) for frame in frames))
        unfinished = folder.with_name(f".{folder.name}")
        try:
            with RecordingWriter(unfinished, header) as writer:
                for frame in frames:
                    writer.add(frame.payload, frame.timestamp_ns)
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)  # it has its name by now, or never will


def _make_room(folder: Path, wanted_bytes: int) -> None:
    """Remove the oldest snapshots, so that one more fits. Errors: OSError."""
    kept = sorted(path for path in folder.iterdir() if path.is_dir() and not path.is_symlink())
    sizes = [sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) for path in kept]
    while kept and (len(kept) >= KEPT or sum(sizes) + wanted_bytes > KEPT_BYTES):
        shutil.rmtree(kept.pop(0))
        sizes.pop(0)
