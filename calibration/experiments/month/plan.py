"""What happens on the line in a month: every piece, how it is put down, and what changes on the gel and the lamps.

A plan is a pure function of part and number of presses. Rates are by press (damage, dust, scars) or by day (batches,
lamps, the gel that is changed). Sizes that no public data show are assumed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.defects import DEFECTS, Defect, place_defect
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.parts import specimen
from calibration.simulator.plan import place_damage
from calibration.simulator.pose import HeightField, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import MASK_DEPTH_MM
from calibration.simulator.scars import Scar, grain, random_scar
from calibration.simulator.shapes import f32
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, F64
from edge.core.errors import ConfigError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES

__all__ = ["DAYS", "DEPTH_MM", "FULL", "NOMINAL", "SETS", "Month", "PlannedPress"]

DAYS: Final = 30
FULL: Final = 10_000
"""Presses of a month."""
DEPTH_MM: Final = 0.4

# Seeds of the parts; what was chosen was chosen on development, and judgement was opened once. 73,000 to 73,002 were
# opened before a station learnt a new gel from its first presses.
SETS: Final[Mapping[str, int]] = {"development": 71_000, "judgement": 73_003}

NOMINAL: Final = (24, 8)
"""Pieces of the fit, and how many of them are pressed twice."""

Truth = Literal["sound", "damaged", "wrong"]

_DAMAGED_SHARE, _WRONG_SHARE = 0.01, 1 / 500
# The fit renders dents and scratches to choose its limit, so these two kinds are not new to a bundle.
_NEW_KINDS: Final = tuple(kind for kind in DEFECTS if kind not in ("dent", "scratch"))
_SEVERITY: Final = (0.3, 1.0)

# A grain settles every 60 presses, as in the simulator's gels; of five one is a hair.
_PRESSES_PER_SPECK, _HAIR_SHARE = 60.0, 0.2
# A speck's radius and height in mm, as the simulator's grains.
_SPECK_MM: Final = ((0.03, 0.1), (0.01, 0.05))
_PRESSES_PER_SCAR: Final = 400.0
_LASTING: Final = ("scratch", "dent", "worn_coat")

_DAYS_PER_BATCH: Final = 3
# Of a batch: its relief is up to 4 % higher or lower, its size differs up to .3 %, its tool marks are 1 to 3 um high.
_BATCH_RELIEF, _BATCH_SIZE, _BATCH_MARKS_MM = 0.04, 0.003, (0.001, 0.003)

# The lamps lose a fifth of their light over the month.
_LIGHT_LOST: Final = 0.2

# The place and depth to which an operator presses wander: sd, with a memory of some 50 presses.
_WANDER_MM, _WANDER_RAD, _WANDER_DEPTH, _MEMORY = 0.15, math.radians(1.0), 0.04, 0.98

_INSPECTED_MM: Final = 6.3
_QUESTIONS: Final = 10


@dataclass(frozen=True)
class Batch:
    """A part as one batch of it is made, within what its drawing allows."""

    nominal: HeightField
    relief: float
    size: float
    mark_mm: float
    """Height of its tool marks."""
    turn_rad: float

    def __call__(self, x_mm: F32, y_mm: F32) -> F32:
        height = self.nominal(x_mm * np.float32(self.size), y_mm * np.float32(self.size))
        along = math.cos(self.turn_rad) * x_mm + math.sin(self.turn_rad) * y_mm
        marks = np.float32(self.mark_mm) * reproducible_math.sin(along * np.float32(2 * math.pi / 0.5))
        return f32(height * np.float32(self.relief) + marks)


@dataclass(frozen=True)
class PlannedPress:
    """One piece that is put under the gel."""

    number: int
    """In the month, from 0."""
    day: int
    truth: Truth
    kind: str
    """Of the damage; empty without."""
    defect: Defect | None
    batch: int
    pose: Pose
    """Where the operator puts it, before the jitter of each press."""
    depth_factor: float
    light: float
    """Share of the lamps' light that is left."""
    speck: Scar | None
    """What settles on the gel before this press and can be wiped off: a grain or a hair."""
    lift_s: float
    """How long the gel is free after the press."""


class Month:
    """The plan of one part. presses: of the month, spread evenly over its days.

    Errors: ConfigError for a random part that lies too low to be touched where it is inspected.
    """

    def __init__(self, which: str, part: int, presses: int, days: int = DAYS) -> None:
        self.which, self.part, self.presses, self.days = which, part, presses, days
        self.seed = SETS[which] + part
        self.streams = Streams(self.seed)
        self.shape: HeightField = random_part(np.random.default_rng([self.seed, 1]))
        self._other: HeightField = random_part(np.random.default_rng([self.seed, 2]))
        try:
            place_defect("dent", 1.0, self.shape, DEPTH_MM, np.random.default_rng(0))
        except ValueError as error:
            raise ConfigError(f"part {part} of {which} cannot be taken: {error}; take another one") from error

    @property
    def questions(self) -> int:
        """How many presses a person is asked about on one day: 10 of a full month, of a smaller one each fifth."""
        return max(1, min(_QUESTIONS, self.presses // self.days // 5))

    def day(self, day: int) -> Sequence[PlannedPress]:
        """Return the presses of a day, from 0."""
        first, last = (self.presses * k // self.days for k in (day, day + 1))
        return [self._press(number, day) for number in range(first, last)]

    def is_gel_changed(self, day: int) -> bool:
        """Tell whether another gel is mounted before a day: in the middle of the month."""
        return day == (self.days + 1) // 2

    def wear(self, presses: int) -> int:
        """Return the presses that a gel is worn by after some of the month: it has its rated life by the middle."""
        return 2 * DEFAULT_LIMIT_PRESSES * presses // self.presses

    def piece(self, press: PlannedPress) -> HeightField:
        """Return the piece, without its damage."""
        nominal = self._other if press.truth == "wrong" else self._batches[press.batch]
        return specimen(nominal, self.streams("specimen", press.number))

    def nominal_piece(self, piece: int) -> HeightField:
        """Return a piece of the fit, which knows one batch only."""
        return specimen(self.shape, self.streams("nominal", piece))

    def scars(self, press: PlannedPress, since: int) -> tuple[tuple[Scar, float], ...]:
        """Return the lasting scars of a gel that was mounted before a press, each with the share that it has grown
        to."""
        shares = ((scar, scar.share(press.number)) for scar in self._lasting if scar.since >= since)
        return tuple((scar, share) for scar, share in shares if share > 0)

    def _press(self, number: int, day: int) -> PlannedPress:
        rng = self.streams("press", number)
        truth, kind = self._truths.get(number, ("sound", ""))
        across, down, turn, depth = self._wander[number].tolist()
        return PlannedPress(
            number=number,
            day=day,
            truth=truth,
            kind=kind,
            defect=self._defect(number, kind) if kind else None,
            batch=day // _DAYS_PER_BATCH,
            pose=Pose((_WANDER_MM * across, _WANDER_MM * down), _WANDER_RAD * turn),
            depth_factor=1 + _WANDER_DEPTH * depth,
            light=1 - _LIGHT_LOST * number / self.presses,
            speck=self._speck(number) if rng.uniform() < 1 / _PRESSES_PER_SPECK else None,
            lift_s=float(rng.uniform(0.3, 1.6)),
        )

    @cached_property
    def _truths(self) -> Mapping[int, tuple[Truth, str]]:
        """Draw which presses are not of sound pieces of the part: as many as the rates give, and one at least."""
        rng = self.streams("truths")
        damaged = max(1, round(self.presses * _DAMAGED_SHARE))
        wrong = max(1, round(self.presses * _WRONG_SHARE))
        drawn = rng.permutation(self.presses)[: damaged + wrong].tolist()
        kinds = [_NEW_KINDS[k % len(_NEW_KINDS)] for k in range(damaged)]
        truths: dict[int, tuple[Truth, str]] = {
            number: ("damaged", kind) for number, kind in zip(drawn, kinds, strict=False)
        }
        return truths | dict.fromkeys(drawn[damaged:], ("wrong", ""))

    @cached_property
    def _wander(self) -> F64:
        """Draw place, turn and depth of every press, float64 (presses, 4), each with mean 0 and sd 1."""
        steps = self.streams("wander").standard_normal((self.presses, 4))
        values, now = np.empty_like(steps), self.streams("wander", "begin").standard_normal(4)
        for number, step in enumerate(steps):
            now = _MEMORY * now + math.sqrt(1 - _MEMORY * _MEMORY) * step
            values[number] = now
        return np.clip(values, -3, 3)

    @cached_property
    def _batches(self) -> Sequence[Batch]:
        drawn = [self.streams("batch", k) for k in range(self.days // _DAYS_PER_BATCH + 1)]
        return [
            Batch(
                self.shape,
                1 + float(rng.uniform(-_BATCH_RELIEF, _BATCH_RELIEF)),
                1 + float(rng.uniform(-_BATCH_SIZE, _BATCH_SIZE)),
                float(rng.uniform(*_BATCH_MARKS_MM)),
                float(rng.uniform(0, math.pi)),
            )
            for rng in drawn
        ]

    @cached_property
    def _lasting(self) -> Sequence[Scar]:
        """Draw the scars of the month: under the part, where presses cut them."""
        rng, number, scars = self.streams("scars"), 0.0, list[Scar]()
        while (number := number + float(rng.exponential(_PRESSES_PER_SCAR))) < self.presses:
            kind = _LASTING[len(scars) % len(_LASTING)]
            scars.append(random_scar(kind, self._spot(rng), int(number), rng))
        return scars

    def _speck(self, number: int) -> Scar:
        """Draw what settles: a grain anywhere on the gel, or a hair."""
        rng = self.streams("speck", number)
        at = tuple(float(rng.uniform(-half, half)) for half in (extent / 2 for extent in LR.extent_mm))
        if rng.uniform() < _HAIR_SHARE:
            return random_scar("hair", (at[0], at[1]), number, rng)
        radius, height = (float(rng.uniform(*ends)) for ends in _SPECK_MM)
        return grain((at[0], at[1]), radius, height, number)

    def _spot(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw a place that the part touches."""
        height = sample(self.shape, Pose(), LR)
        x, y = grids(LR)
        inside = (np.abs(x) < _INSPECTED_MM) & (np.abs(y) < _INSPECTED_MM)
        rows, columns = np.nonzero((height > -DEPTH_MM) & inside)
        at = int(rng.integers(len(rows)))
        return float(x[0, columns[at]]), float(y[rows[at], 0])

    def _defect(self, number: int, kind: str) -> Defect:
        rng = self.streams("defect", number)
        severity = float(rng.uniform(*_SEVERITY))
        return place_damage(self.shape, kind, severity, DEPTH_MM, MASK_DEPTH_MM, rng)
