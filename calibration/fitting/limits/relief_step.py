"""What a smoother object lacks, learnt from the nominal presses alone, and whether it is worth checking.

A score map shows what a press has and nominal presses have not; a smoother press, or one that barely touches, has
nothing of that. So the finest tap is asked how rough the press is where it touches, whatever its light and wherever the
part lies. With f a cell's features:

    contact = clip(|f - free| / level - 1/2, 0, 1)
    lack    = weights . f - middle                         0 on a nominal press, 1 at the limit
    smooth  = sum(contact * lack) / (sum(contact) + weakest)
    faint   = 11 weakest / (10 sum(contact) + weakest)     1 where the contact is as weak as the weakest allowed
    missing = max(smooth, faint)

The map shows the places that lack most, and is 0 until `missing` comes near its limit: so it changes no score of a
press whose relief is there. All of it is float64 NumPy; `appended` writes the same into a head.

The direction in the finest tap that separates smoother presses from nominal ones, and neither light, exposure and
contrast nor one nominal press from the next: Fisher's linear discriminant of the features averaged over the contact.
The smoother presses are rendered into the nominal ones, and each press is judged by what the other folds teach.

Ref: Fisher, The use of multiple measurements in taxonomic problems, Annals of Eugenics 7 (1936).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.conditions import ChangedPresses, change_presses
from calibration.fitting.limits.appended import append, find_obstacle, head_inputs
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.held_out import Learner
from calibration.fitting.presses.augmentation import Take
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.arrays import F64, Mask
from edge.core.detector import Bank, Grid, Nominal
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from plugins.detectors.common.smoothing import Smoothing

__all__ = [
    "USEFUL",
    "Relief",
    "ReliefChoice",
    "choose_relief",
    "contact_of",
    "find_missing",
    "finest_tap",
    "pool",
    "try_relief",
]

Floating = NDArray[np.floating]

Relief = Mapping[str, NDArray[Any]]
"""What tells a smoother press from a nominal one, as the arrays of a bank: `relief_free` (channels, 1, 1), `_weights`
(1, channels, 1, 1), `_middle` (1,), `_expected` (the mean contact of nominal presses by cell), `_rows` and `_columns`
(they bring cells to the score map), and the numbers `_level`, `_weakest` and `_unit` (the score at the limit), (1, 1).
"""

# No contact at all is this many times and one beyond the limit: a quotient needs an end.
_FAINT = 10.0
# A sum that is 0 has no peak to divide by.
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Pooled:
    """Presses over their contact."""

    means: F64
    """Mean features, float64 (n, channels)."""
    contact: F64
    """Cells in contact, float64 (n,)."""

    def __getitem__(self, rows: Mask | NDArray[np.int64]) -> "Pooled":
        return Pooled(self.means[rows], self.contact[rows])


def contact_of(features: Floating, free: F64, level: float) -> F64:
    """Return how much each cell touches, 0 to 1, float64 (n, h, w).

    features: (n, channels, h, w). free: those of the free gel, (channels, 1, 1).
    """
    distance = np.sqrt(np.square(features - free).sum(axis=1))
    return np.asarray(np.clip(distance / level - 0.5, 0, 1))


def pool(features: Floating, free: F64, level: float) -> Pooled:
    """Pool the presses' features (n, channels, h, w), averaged over what touches; press by press, for their size."""
    means, contact = np.zeros(features.shape[:2]), np.zeros(len(features))
    for k, press_maps in enumerate(features):
        touch = contact_of(press_maps[None], free, level)[0]
        contact[k] = touch.sum()
        means[k] = np.tensordot(press_maps.astype(np.float64), touch, 2) / max(contact[k], _TINY)
    return Pooled(means, contact)


def find_missing(relief: Relief, features: Floating) -> F64:
    """Return how much relief is missing from features (n, channels, h, w), float64 (n,), 1 at the limit."""
    presses = pool(features, relief["relief_free"], float(relief["relief_level"].item()))
    lack = presses.means @ relief["relief_weights"][0, :, 0, 0] + relief["relief_middle"]
    weakest = relief["relief_weakest"].item()
    smooth = lack * presses.contact / (presses.contact + weakest)
    return np.asarray(np.maximum(smooth, (_FAINT + 1) * weakest / (_FAINT * presses.contact + weakest)))


USEFUL = 0.6
"""The share of the smoother presses that must be found; a part with little relief can lack little."""

# A cell touches half at this share of the distance that the most changed cells of a press have from the free gel.
_LEVEL_SHARE, _HIGHEST = 0.35, 0.995
# A contact of less than this share of the weakest nominal one shows no relief to judge by.
_WEAKEST_SHARE = 0.25
# A learnt press with less than this share of the usual contact has none: some cells of any free gel differ.
_LEAST_SHARE = 0.05
# Presses whose contact is weaker than this share of the usual one say little of the features of a contact.
_USUAL_SHARE = 0.3
# Fisher's within-class scatter: what conditions change counts this many times, and the scatter of single cells by this
# share, which keeps it regular with few presses.
_CONDITIONS, _CELLS = 4.0, 0.05
_MOST_CELLS = 4096
# The limit lies below the lowest nominal press by these shares of its distance from the middle, and from the smoother.
_BEYOND_NOMINAL, _BEYOND_SMOOTHER = 0.25, 0.25
# Of each condition this share of the presses may lie lower: a rendered condition is no nominal press.
_LOWEST_SHARE = 0.1
# The map of missing relief is blurred by this standard deviation.
_BLUR_MM = 0.38


@dataclass(frozen=True, eq=False)
class ReliefChoice:
    """Whether missing relief is checked, and why."""

    why: str
    relief: Relief | None = None
    """The check, with a unit of 1; None where nothing is checked."""
    tap: str = ""
    """The tap whose features are read."""
    found: float | None = None
    """The share of smoother presses that are found; None where none was tried."""

    def facts(self) -> dict[str, Any]:
        """Return the choice for the manifest."""
        known = {} if self.found is None else {"found": round(self.found, 4)}
        tap = {"tap": self.tap} if self.tap else {}
        return {"is_checked": self.relief is not None, "why": self.why, **known, **tap}

    def append_to(self, head: bytes, bank: Bank, unit: float) -> tuple[bytes, Bank]:
        """Append the check to head and bank, where there is one. unit: the score at the limit. Errors: FitError."""
        if self.relief is None:
            return head, bank
        return append(head, bank, {**self.relief, "relief_unit": np.full((1, 1), unit)}, self.tap)


def try_relief(
    presses: NominalPresses,
    view: tuple[SensorProfile, Region],
    nominal: Nominal,
    take: Take,
    folds: Folds,
    learner: Learner,
    head: bytes,
) -> ReliefChoice:
    """Learn what the station's presses allow. take: the features of frames. head: the graph that is to be extended."""
    tap = finest_tap(learner.grid, head_inputs(head))
    obstacle = "the head reads no tap" if tap is None else find_obstacle(head)
    if tap is None or obstacle:
        return ReliefChoice(f"it cannot be appended to the method's graph: {obstacle}")
    changed = change_presses(presses, *view, np.random.default_rng(learner.seed))
    if changed is None:
        return ReliefChoice("no contact is seen to make smoother")
    return choose_relief(nominal, changed, take, folds, learner.grid, tap)


def finest_tap(grid: Grid, read: Sequence[str]) -> str | None:
    """The tap with the most cells, of those that a head reads; None where it reads none."""
    cells = {tap: grid.taps[tap][1] * grid.taps[tap][2] for tap in read if tap in grid.taps}
    return max(cells, key=lambda tap: cells[tap]) if cells else None


def choose_relief(
    nominal: Nominal, changed: ChangedPresses, take: Take, folds: Folds, grid: Grid, tap: str
) -> ReliefChoice:
    """Learn what tells a smoother press, from nominal presses (with features of the free gel) and changed ones."""
    evidence = _Evidence.of(nominal, changed, take, tap)
    contact = evidence.nominal.contact
    if contact.min() <= _LEAST_SHARE * np.median(contact):
        return ReliefChoice("a learnt press hardly touches")
    held_out = evidence.score_folds(folds)
    if held_out.limit >= 0:
        return ReliefChoice("the nominal presses differ more than smoother ones do from them")
    share = float(np.mean([values < held_out.limit for values in held_out.smoother]))
    count = held_out.smoother.size
    words = f"{round(share * count)} of {count} smoother presses"
    if share < USEFUL:
        return ReliefChoice(
            f"of the part's relief little can be missing: only {words} are found", found=share
        )
    weights, middle = evidence.direction(np.arange(nominal.presses))
    _, rows, columns = grid.taps[tap]
    raised = Smoothing.of(grid, (rows, columns), _BLUR_MM, "sampled")
    relief = {
        "relief_free": evidence.free,
        "relief_level": np.full((1, 1), evidence.level),
        "relief_weights": (weights / held_out.limit)[None, :, None, None],
        "relief_middle": np.array([-middle / held_out.limit]),
        "relief_weakest": np.full((1, 1), evidence.weakest),
        "relief_expected": evidence.expected,
        "relief_rows": raised.rows,
        "relief_columns": raised.columns.T,
        "relief_unit": np.ones((1, 1)),
    }
    is_alarm = held_out.same < held_out.limit
    alarms = f"{int(is_alarm.sum())} of {is_alarm.size} nominal ones under another light or contrast"
    return ReliefChoice(f"{words} are found, and {alarms}", relief, tap, share)


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Roughness by directions learnt without the press, 0 in the middle; of nominal ones the lower of that and of the
    final direction's, which knows them."""

    nominal: F64
    """Values of nominal presses, (n,)."""
    same: F64
    smoother: F64
    """As `same`, of changed presses, (kinds, m)."""

    @property
    def limit(self) -> float:
        """Below every nominal press, and further by a share of the way to the smoother ones."""
        lowest = min(float(self.nominal.min()), float(np.quantile(self.same, _LOWEST_SHARE, axis=1).min()))
        to_smoother = lowest - float(np.median(self.smoother, axis=1).max())
        return lowest - max(-_BEYOND_NOMINAL * lowest, _BEYOND_SMOOTHER * to_smoother)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Everything pooled over the contact."""

    free: F64
    level: float
    expected: F64
    nominal: Pooled
    press: NDArray[np.int64]
    """Which nominal press each changed one was, (m,)."""
    same: tuple[Pooled, ...]
    smoother: tuple[Pooled, ...]
    cells: F64
    """The scatter of single touched cells, (channels, channels)."""

    @classmethod
    def of(cls, nominal: Nominal, changed: ChangedPresses, take: Take, tap: str) -> "_Evidence":
        maps, untouched = nominal.features[tap], (nominal.no_contact or nominal.features)[tap]
        free = np.median(untouched.mean(axis=0, dtype=np.float64), axis=(1, 2), keepdims=True)
        distances = [np.sqrt(np.square(score_map - free).sum(axis=0)) for score_map in maps]
        level = _LEVEL_SHARE * float(np.median([np.quantile(distance, _HIGHEST) for distance in distances]))
        expected = np.mean([contact_of(score_map[None], free, level)[0] for score_map in maps], axis=0)
        same, smoother = (
            tuple(pool(take(frames)[tap], free, level) for frames in kinds)
            for kinds in (changed.same, changed.smoother)
        )
        cells = _touched_cells(maps[changed.press], free, level)
        nominal_presses = pool(maps, free, level)
        return cls(free, level, expected, nominal_presses, changed.press, same, smoother, np.cov(cells.T))

    @property
    def weakest(self) -> float:
        return _WEAKEST_SHARE * float(self.nominal.contact.min())

    def score_folds(self, folds: Folds) -> _HeldOut:
        """Score every press by the direction of the other folds."""
        nominal = np.zeros(len(self.nominal.contact))
        same, smoother = (np.zeros((len(kinds), len(self.press))) for kinds in (self.same, self.smoother))
        for held in folds:
            direction = self.direction(np.setdiff1d(np.arange(len(nominal)), held))
            nominal[held] = self.roughness(self.nominal[held], direction)
            rows = np.isin(self.press, held)
            for values, kinds in ((same, self.same), (smoother, self.smoother)):
                values[:, rows] = [self.roughness(kind[rows], direction) for kind in kinds]
        known = self.roughness(self.nominal, self.direction(np.arange(len(nominal))))
        return _HeldOut(np.minimum(nominal, known), same, smoother)

    def roughness(self, presses: Pooled, direction: tuple[F64, float]) -> F64:
        weights, middle = direction
        shown = presses.contact / (presses.contact + self.weakest)
        return np.asarray((presses.means @ weights - middle) * shown)

    def direction(self, known: NDArray[np.int64]) -> tuple[F64, float]:
        """Weights (channels,) and the median of the known presses by them: higher is rougher."""
        usual = _USUAL_SHARE * np.median(self.nominal.contact)
        rows = np.isin(self.press, known) & (self.nominal.contact[self.press] > usual)
        shown = known[self.nominal.contact[known] > usual]
        if not rows.any():
            rows = np.isin(self.press, known)
        base = self.nominal.means[self.press[rows]]
        means = self.nominal.means[shown]
        within = _scatter(means - means.mean(axis=0)) + _CELLS * self.cells
        changes = [kind.means[rows] - base for kind in self.same]
        within = within + _CONDITIONS * np.mean([_scatter(change) for change in changes], axis=0)
        smoother = np.mean([kind.means[rows] - base for kind in self.smoother], axis=(0, 1))
        eye = np.eye(len(within))
        # Regular where a channel never changes.
        least = 1e-6 * float(np.trace(within)) / len(within) * eye + 1e-12 * eye
        weights = -np.linalg.solve(within + least, smoother)
        weights = weights / max(float(np.sqrt(weights @ within @ weights)), float(np.finfo(np.float32).tiny))
        return weights, float(np.median(means @ weights))


def _touched_cells(maps: Floating, free: F64, level: float) -> F64:
    """Features of cells in the middle of a contact, float64 (k, channels)."""
    most = max(1, _MOST_CELLS // len(maps))
    cells = []
    for press_maps in maps:
        touching = press_maps[:, contact_of(press_maps[None], free, level)[0] > 0.8].T
        cells.append(touching[:: max(1, len(touching) // most)])
    return np.concatenate(cells).astype(np.float64)


def _scatter(rows: F64) -> F64:
    return np.asarray(rows.T @ rows / max(len(rows) - 1, 1))
