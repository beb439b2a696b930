"""The folder of an acquisition: every press is a complete file as soon as it is taken, so nothing is lost.

    acquisition.json   what is pressed and how it is seen; an acquisition continues only with the same
    presses/           the camera's bytes: <part>_<position>_s<piece>_p<press>, or press_<number> of unknown pieces
    free/              pictures of the free gel
    signals.jsonl      what was printed after each press, and the name of its piece where the source has one
    coverage.png       where presses still show something new

`gelgate fit FOLDER` learns from it. A press is known by its bytes: a source that is
read again after an interruption gives the same presses, and they are not taken twice.
"""

import fcntl
import hashlib
import itertools
import json
import os
import re
import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from weakref import finalize

from calibration.dataset.press import numbered
from calibration.fitting.presses.sources import ACQUISITION
from calibration.folders import claim, write_whole
from edge.core.errors import ConfigError, StoreError
from edge.core.imaging.image_bytes import kind

__all__ = ["AcquisitionFolder", "KeptPress", "Keys", "Pieces"]

MOST_FREE = 16
"""Pictures of the free gel that are kept: the detectors need only its mean and its noise."""

_VERSION = 1


@dataclass(frozen=True)
class KeptPress:
    """A press in the folder."""

    path: Path
    piece: int | None
    """Its number, None where pieces are not known."""


class AcquisitionFolder:
    """Opens or begins an acquisition. presses: in the order in which they were taken.

    about: what it is of: part, position, profile and region. close: lets others take presses into it. Errors:
    ConfigError for a folder that holds something else, or another acquisition, or that another one fills; StoreError.
    """

    def __init__(self, root: Path, about: Mapping[str, str]) -> None:
        self.root, self.about = root, about
        self.close = finalize(self, _hold(root).close)
        claim(root, ACQUISITION, {"version": _VERSION, **about}, "acquisition", ConfigError)
        try:
            for part in ("presses", "free"):
                (root / part).mkdir(exist_ok=True)
        except OSError as error:
            raise self._refusal(error) from error
        self.presses: list[KeptPress] = []
        for path in sorted(
            (root / "presses").iterdir(), key=lambda path: (path.stat().st_mtime_ns, path.name)
        ):
            if path.suffix == ".part":
                path.unlink()
                continue
            name = numbered(path.stem)
            self.presses.append(KeptPress(path, int(name.specimen) if name else None))
        self._known = {_digest(kept.path.read_bytes()): kept for kept in self.presses}

    @property
    def free(self) -> list[Path]:
        """The pictures of the free gel."""
        return sorted(path for path in (self.root / "free").iterdir() if path.suffix != ".part")

    @property
    def named(self) -> dict[str, int]:
        """The numbers of the pieces that sources have named, by these names."""
        try:
            lines = (self.root / "signals.jsonl").read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            return {}
        names = {row["file"]: row.get("piece") for line in lines if (row := _read_row(line))}
        pieces = [(names.get(kept.path.name), kept.piece) for kept in self.presses]
        return {name: piece for name, piece in pieces if isinstance(name, str) and piece is not None}

    def find(self, payload: bytes) -> KeptPress | None:
        """Return the press with these bytes, if it is here."""
        return self._known.get(_digest(payload))

    def add(self, payload: bytes, piece: int | None) -> KeptPress:
        """Keep a press; it is on the disk when this returns. Errors: StoreError."""
        kept = KeptPress(self._write(self._name(piece), payload), piece)
        self.presses.append(kept)
        self._known[_digest(payload)] = kept
        return kept

    def add_free(self, payload: bytes) -> None:
        """Keep a picture of the free gel, if there is room for one. Errors: StoreError."""
        count = len(self.free)
        if count < MOST_FREE:
            self._write(self._unused("free/free_{:02d}", count), payload)

    def log(self, signals: Mapping[str, object]) -> None:
        """Append what was printed after a press. Errors: StoreError."""
        try:
            with (self.root / "signals.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(dict(signals)) + "\n")
        except OSError as error:
            raise self._refusal(error) from error

    def picture(self, png: bytes) -> Path:
        """Write the map of the coverage. Errors: StoreError."""
        return self._write("coverage", png)

    def _name(self, piece: int | None) -> str:
        if piece is None:
            return self._unused("presses/press_{:04d}", len(self.presses))
        of_piece = sum(kept.piece == piece for kept in self.presses)
        where = re.sub(
            r"[^A-Za-z0-9-]+", "-", f"{self.about['part']}_{self.about['position']}".replace("_", "-")
        )
        return self._unused(f"presses/{where}_s{piece:03d}_p{{:02d}}", of_piece)

    def _unused(self, name: str, kept: int) -> str:
        """Return the first name after those kept that no file has: people remove pictures."""
        names = (name.format(number) for number in itertools.count(kept + 1))
        return next(file_name for file_name in names if not any(self.root.glob(f"{file_name}.*")))

    def _write(self, name: str, payload: bytes) -> Path:
        """A complete file or none; after a power cut, too."""
        path = self.root / f"{name}.{kind(payload) or 'bmp'}"
        try:
            write_whole(path, payload)
        except OSError as error:
            raise self._refusal(error) from error
        return path

    def _refusal(self, error: OSError) -> StoreError:
        return StoreError(
            f"the acquisition {self.root} cannot be written: {error.strerror or error}; the presses so far are kept, "
            "free some space and start again with the same command"
        )


def _hold(root: Path) -> ExitStack:
    """Keep others from taking presses into a folder until this is closed. Errors: ConfigError where one does."""
    with ExitStack() as held:
        try:
            root.mkdir(parents=True, exist_ok=True)
            handle = os.open(root, os.O_RDONLY)
            held.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"another process takes presses into {root}; wait for its end, or choose another folder"
            ) from None
        except OSError:
            pass  # what cannot be written is said next, and NFS locks no folder
        return held.pop_all()


def _read_row(line: str) -> dict[str, object] | None:
    """Read what was printed after a press; None for half a line, of a program that was killed."""
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) and isinstance(row.get("file"), str) else None


def _digest(payload: bytes) -> str:
    return hashlib.sha256(payload).hexdigest()


class Keys:
    """Counts the lines that a person enters, in a thread of its own: each says that a new piece is in place."""

    def __init__(self, lines: Iterable[str]) -> None:
        self._lines, self._guard, self._entered = lines, threading.Lock(), 0
        threading.Thread(target=self._read, daemon=True).start()

    def take(self) -> int:
        """The lines entered since the last call."""
        with self._guard:
            entered, self._entered = self._entered, 0
        return entered

    def _read(self) -> None:
        for _ in self._lines:
            with self._guard:
                self._entered += 1


class Pieces:
    """Numbers the pieces from 1, in the order in which they are first pressed.

    kept: the presses of earlier runs. each: presses of each piece, where they are counted; None otherwise. keys: where
    an operator says when a new piece is in place.
    """

    def __init__(self, kept: Iterable[KeptPress], each: int | None = None, keys: Keys | None = None) -> None:
        self._each, self._keys = each, keys
        self._numbers: dict[str, int] = {}
        self._presses = Counter(press.piece for press in kept if press.piece is not None)
        self._newest = max(self._presses, default=0)

    @property
    def is_waiting(self) -> bool:
        """True where the next press is of a new piece because this one has all its presses."""
        return self._each is not None and self._presses[self._newest] >= self._each

    @property
    def next(self) -> int:
        """The number of the next new piece."""
        return self._newest + 1

    def of(self, name: str | None) -> int | None:
        """The piece of the press that was just made. name: the source's own, None where it has none."""
        if name is not None:
            return self._count(self._numbers.setdefault(name, self.next))
        if self._keys is None and self._each is None:
            return None
        is_new = self.is_waiting if self._keys is None else self._keys.take() > 0
        return self._count(self.next if is_new or not self._newest else self._newest)

    def see_again(self, name: str | None, piece: int | None) -> None:
        """Take a piece of an earlier run that came again: its name belongs to that number."""
        if name is not None and piece is not None:
            self._numbers[name] = piece

    def _count(self, piece: int) -> int:
        self._presses[piece] += 1
        self._newest = max(self._newest, piece)
        return piece
