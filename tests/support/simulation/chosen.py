"""What a seed chooses, and the schedule of a run's faults: drawn, or given so that it plays again."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Fault:
    """One fault of a schedule. seed: of what it draws, as how long it lasts."""

    at_s: float
    name: str
    seed: int


@dataclass(frozen=True)
class Chosen:
    """The options of a run. rates: faults per simulated minute, of those that are drawn."""

    brokers: int = 1
    has_archive: bool = True
    rates: dict[str, float] = field(default_factory=dict)
    sloth_s: float = 0.0
    """The longest wait of a ready actor for its turn."""
    fps: float = 18.75
    level: str = "5"
    """Of MQTT, that the brokers speak: `5`, `3.1.1`, or `silent at 5`."""

    @classmethod
    def of(cls, rng: random.Random, names: Sequence[str]) -> "Chosen":
        """Draw. Each kind of fault is left out of half of the runs or more, so that others meet alone."""
        share = rng.choice((0.15, 0.5))
        rates = {name: rng.choice((1.0, 4.0)) for name in names if rng.random() < share}
        return cls(
            rng.choice((1, 1, 2)),
            rng.random() < 0.5,
            rates,
            rng.choice((0.0, 0.01, 0.03)),
            rng.choice((18.75, 9.0, 9.0, 7.0)),
            rng.choice(("5", "5", "5", "3.1.1", "silent at 5")),
        )
