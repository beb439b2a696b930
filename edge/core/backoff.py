"""How long to wait before trying again."""

import random
from dataclasses import dataclass

__all__ = ["Backoff"]


@dataclass
class Backoff:
    """The pause after the n-th failure in a row: doubling up to a ceiling, half of it random.

    The random half keeps a plant's gateways from returning to a restarted broker at the same instant.
    """

    rng: random.Random
    first_s: float
    ceiling_s: float
    failures: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.first_s <= self.ceiling_s:
            raise ValueError(f"0 < first_s <= ceiling_s is needed, found {self.first_s} and {self.ceiling_s}")

    def failed(self) -> float:
        """Count one more failure; returns the seconds to wait."""
        full = min(self.ceiling_s, self.first_s * float(2 ** min(self.failures, 16)))
        self.failures += 1
        return full / 2 + self.rng.uniform(0, full / 2)

    def succeeded(self) -> None:
        self.failures = 0
