"""Named random streams: removing one effect never changes another.

A stream depends only on the seed and on words such as ("noise", "PZ1", "pos2", 17, 3). So no stream shifts another, and
a resumed run draws the same numbers as an uninterrupted one.
"""

import zlib
from dataclasses import dataclass

import numpy as np

__all__ = ["Streams"]


@dataclass(frozen=True)
class Streams:
    """Gives the generator of some words; equal seeds and words give equal draws."""

    seed: int

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"a seed is a number from 0 up, found {self.seed}")

    def __call__(self, *words: str | int) -> np.random.Generator:
        # Numbers and text get different tags, so that ("a", 1) and ("a", "1") are different streams.
        tagged = [(0, word) if isinstance(word, int) else (1, zlib.crc32(word.encode())) for word in words]
        key = [part for pair in tagged for part in pair]
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence([self.seed, *key])))
