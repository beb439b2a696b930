"""Named random streams: removing one effect never changes another.

A stream depends only on the seed and on words such as ("noise", "PZ1", "pos2", 17, 3). So no stream shifts another, and
a resumed run draws the same numbers as an uninterrupted one.
"""

import zlib
from dataclasses import dataclass
from typing import Protocol

import numpy as np

__all__ = ["Streams", "make_streams"]


class Streams(Protocol):
    """Gives the generator of these words; equal words give equal draws."""

    def __call__(self, *words: str | int) -> np.random.Generator: ...
    def __hash__(self) -> int: ...


@dataclass(frozen=True)
class _NamedStreams:
    seed: int

    def __call__(self, *words: str | int) -> np.random.Generator:
        # Numbers and text get different tags, so that ("a", 1) and ("a", "1") are different streams.
        key = [part for word in words for part in _entropy(word)]
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence([self.seed, *key])))


def make_streams(seed: int) -> Streams:
    """The streams of one seed; equal seeds give equal streams. Errors: ValueError for a negative seed."""
    if seed < 0:
        raise ValueError(f"a seed is a number from 0 up, found {seed}")
    return _NamedStreams(seed)


def _entropy(word: str | int) -> tuple[int, int]:
    if isinstance(word, int):
        return (0, word)
    return (1, zlib.crc32(word.encode()))
