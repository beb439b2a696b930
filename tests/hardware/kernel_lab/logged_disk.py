"""A disk whose writes the kernel logs, and that is made again as a power cut at any moment would leave it.

Ref: https://docs.kernel.org/admin-guide/device-mapper/log-writes.html; `struct dm_ioctl` of linux/dm-ioctl.h; `struct
log_write_entry` of drivers/md/dm-log-writes.c. A write is in the log when a flush, or its own FUA, has made it last.
"""

import ctypes
import fcntl
import os
import random
import struct
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

SECTOR = 512
DISK_BYTES = 24 << 20
DISK, LOG, COPY = "/dev/ram0", "/dev/ram1", "/dev/ram2"
CREATE, REMOVE, RESUME, LOAD, MESSAGE = 3, 4, 6, 9, 14
FLUSH, FUA, DISCARD, MARK = 1, 2, 4, 8
NAME = b"logged"
LIBC = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Entry:
    """One entry of the log."""

    start: int
    """In bytes."""
    flags: int
    data: bytes
    """What was written; the name of a mark."""


def _control(command: int, data: bytes = b"", targets: int = 0) -> None:
    """Ask device-mapper for something about the logged disk."""
    size = 312 + len(data)
    head = struct.pack("<3I I I I i I I I Q 128s 136x", 4, 0, 0, size, 312, targets, 0, 0, 0, 0, 0, NAME)
    with open("/dev/mapper/control", "rb") as control:
        fcntl.ioctl(control, 3 << 30 | 312 << 16 | 0xFD << 8 | command, bytearray(head + data))


def mark(name: str) -> None:
    """Mark this moment in the log."""
    _control(MESSAGE, struct.pack("<Q", 0) + b"mark " + name.replace(" ", "\\ ").encode() + b"\0")


@contextmanager
def mounting(device: str, folder: Path) -> Iterator[Path]:
    """Mount ext4 in its default mode. Errors: OSError."""
    folder.mkdir(exist_ok=True)
    if LIBC.mount(device.encode(), bytes(folder), b"ext4", 0, b""):
        raise OSError(ctypes.get_errno(), f"{device} cannot be mounted")
    try:
        yield folder
    finally:
        if LIBC.umount2(bytes(folder), 0):
            raise OSError(ctypes.get_errno(), f"{folder} is busy")


@contextmanager
def logging_writes(folder: Path, log: list[Entry]) -> Iterator[bytes]:
    """Mount a new logged disk, and yield its first content; at the end the log is filled."""
    for knob in ("writeback", "expire"):  # what is not synced reaches the disk, too
        Path(f"/proc/sys/vm/dirty_{knob}_centisecs").write_text("20")
    subprocess.run(["mkfs.ext4", "-q", "-F", "-b", "4096", DISK, f"{DISK_BYTES >> 10}k"], check=True)
    with open(DISK, "rb") as file:
        first = file.read(DISK_BYTES)
    _control(CREATE)
    target = f"{DISK} {LOG}".encode().ljust(64, b"\0")
    spec = struct.pack("<QQiI16s", 0, DISK_BYTES // SECTOR, 0, 40 + len(target), b"log-writes")
    _control(LOAD, spec + target, 1)
    _control(RESUME)
    try:
        with mounting("/dev/dm-0", folder):
            yield first
    finally:
        _control(REMOVE)
    log += _read_log()


def _read_log() -> Iterator[Entry]:
    with open(LOG, "rb") as file:
        _, _, count, size = struct.unpack("<QQQI", file.read(28))
        file.seek(size)
        for _ in range(count):
            head = file.read(size)
            sector, sectors, flags, length = struct.unpack_from("<4Q", head)
            data = head[32 : 32 + length] if flags & MARK else b""
            if not flags & (MARK | DISCARD):
                data = file.read(sectors * size)
            yield Entry(sector * size, flags, data)


def cut_power(first: bytes, log: Sequence[Entry], cuts: Sequence[int], rng: random.Random) -> Iterator[int]:
    """Make the disk at COPY as power cuts leave it, each after so many entries of the log; yields each number.

    What was flushed is there, and of all else any subset of the sectors.
    """
    disk, done = bytearray(first), 0
    for cut in sorted(cuts):
        flushed = max((at for at in range(done, cut) if log[at].flags & FLUSH), default=done)
        for entry in log[done:flushed]:
            _write(disk, entry)
        done, torn = flushed, bytearray(disk)
        share = rng.choice((0.0, 0.5, 0.5, 1.0))
        is_torn = rng.random() < 0.5
        for entry in log[done:cut]:
            if entry.flags & FUA or (not is_torn and rng.random() < share):
                _write(torn, entry)
            elif is_torn:
                for start in range(0, len(entry.data), SECTOR):
                    if rng.random() < share:
                        _write(torn, Entry(entry.start + start, 0, entry.data[start : start + SECTOR]))
        with open(COPY, "r+b") as file:
            file.write(torn)
            file.flush()
            os.fsync(file.fileno())
        yield cut


def _write(disk: bytearray, entry: Entry) -> None:
    if not entry.flags & (MARK | DISCARD):
        disk[entry.start : entry.start + len(entry.data)] = entry.data
