"""Which piece is pressed: by the source's own names, by counting presses, or by a key of the operator."""

import threading
from collections.abc import Iterable

from calibration.acquisition.folder import KeptPress

__all__ = ["Keys", "Pieces"]


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
        self._presses: dict[int, int] = {}
        for press in kept:
            if press.piece is not None:
                self._presses[press.piece] = self._presses.get(press.piece, 0) + 1
        self._newest = max(self._presses, default=0)

    @property
    def is_waiting(self) -> bool:
        """Whether the next press is of a new piece because this one has all its presses."""
        return self._each is not None and self._presses.get(self._newest, 0) >= self._each

    @property
    def next(self) -> int:
        """The number of the next new piece."""
        return self._newest + 1

    def of(self, name: str | None) -> int | None:
        """The piece of the press that was just made. name: the source's own, None where it has none."""
        if name is not None:
            return self._counted(self._numbers.setdefault(name, self.next))
        if self._keys is not None:
            is_new = self._keys.take() > 0
            return self._counted(self.next if is_new or not self._newest else self._newest)
        if self._each is not None:
            return self._counted(self.next if self.is_waiting or not self._newest else self._newest)
        return None

    def seen(self, name: str | None, piece: int | None) -> None:
        """A press of an earlier run came again: its name belongs to that number."""
        if name is not None and piece is not None:
            self._numbers[name] = piece

    def _counted(self, piece: int) -> int:
        self._presses[piece] = self._presses.get(piece, 0) + 1
        self._newest = max(self._newest, piece)
        return piece
