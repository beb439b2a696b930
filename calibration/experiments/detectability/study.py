"""The places of a contact: a grid over the inspected region, and spots in it where a press touches."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from calibration.experiments.detectability.judges import MIN_PRESSES, Judge, choose_judges
from calibration.fitting.damage.damage import KINDS, Spot
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress
from calibration.fitting.presses.colours import refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.simulator.field_of_view import CROP_MM, Field, grids
from calibration.threads import one_blas_thread
from edge.core.arrays import Mask
from edge.core.errors import DatasetError, NotScorable
from edge.model.bundle import Bundle
from edge.model.detectability import JudgedBy

__all__ = ["Place", "PlaceGrid", "Plan", "Row", "Settings", "plan", "run", "touched_places"]

# A press touches a place where it touches this share of it; a place is of the contact where half of the presses do.
_TOUCHED_SHARE = 0.1
_PRESSES_SHARE = 0.5


Place = tuple[int, int]
"""One cell of the grid, by its row and column."""

Row = Mapping[str, Any]
"""One kind of damage at one spot of one press: the smallest size found is in (low_mm, high_mm], null is infinite."""


@dataclass(frozen=True)
class PlaceGrid:
    """Equal cells over a field, about `spacing_mm` wide. Errors: ValueError for a spacing that is not positive."""

    field: Field
    spacing_mm: float

    def __post_init__(self) -> None:
        if not self.spacing_mm > 0:
            raise ValueError(f"the spacing of places is positive, found {self.spacing_mm} mm")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        across, down = (max(1, round(extent / self.spacing_mm)) for extent in self.field.extent_mm)
        return down, across

    def middle_mm(self, place: Place) -> tuple[float, float]:
        """The middle of a place: x right and y down from the middle of the region."""
        (row, column), (rows, columns), (width, height) = place, self.shape, self.field.extent_mm
        return ((column + 0.5) / columns - 0.5) * width, ((row + 0.5) / rows - 0.5) * height

    def pixels(self, place: Place) -> tuple[slice, slice]:
        """The rows and columns of pixels of a place."""
        sides = zip(place, self.shape, self.field.shape, strict=True)
        down, across = (slice(round(k * size / n), round((k + 1) * size / n)) for k, n, size in sides)
        return down, across

    def touched(self, contact: Mask, place: Place) -> bool:
        """Say whether a press with this contact, bool (h, w), touches the place."""
        return bool(contact[self.pixels(place)].mean() >= _TOUCHED_SHARE)

    def spot(self, contact: Mask, place: Place, rng: np.random.Generator) -> Spot | None:
        """A spot in the place where the press touches, with any direction; None where it does not touch it."""
        cell = self.pixels(place)
        if not self.touched(contact, place):
            return None
        x, y = (axis[cell][contact[cell]] for axis in grids(self.field))
        pick = rng.integers(len(x))
        return Spot(float(x[pick]), float(y[pick]), float(rng.uniform(0, math.pi)))


def touched_places(grid: PlaceGrid, contacts: Sequence[Mask]) -> tuple[Place, ...]:
    """The places that at least half of the presses touch, row by row. contacts: bool (h, w) each."""
    return tuple(
        place
        for place in product(range(grid.shape[0]), range(grid.shape[1]))
        if np.mean([grid.touched(contact, place) for contact in contacts]) >= _PRESSES_SHARE
    )


FORMAT = 1
"""Of a row; rows of another format are done again."""

# The light's response is known for the maker's crop alone; another crop shows another part of the gel.
_CROP_TOLERANCE = 0.1


@dataclass(frozen=True)
class Settings:
    """kinds: of damage. presses: how many are edited at most. spacing_mm: between places. seed: fixes every choice."""

    kinds: tuple[str, ...] = tuple(KINDS)
    presses: int = 8
    spacing_mm: float = 1.5
    seed: int = 0
    threads: int = 2


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that a study needs, before its first trial."""

    bundle: Bundle
    settings: Settings
    grid: PlaceGrid
    presses: dict[str, EditedPress]
    """To edit, by their names."""
    judges: dict[str, Judge]
    """The judge of each press."""
    places: tuple[Place, ...]
    by: JudgedBy
    false_alarms: tuple[str, ...]
    """Names of presses that fail without damage; they are not edited."""
    refused: tuple[str, ...]
    """Names of presses of another sensor."""

    @property
    def total(self) -> int:
        """Trials at most: a press that does not touch a place has none there."""
        return len(self.settings.kinds) * len(self.places) * len(self.presses)

    def key(self, kind: str, place: Place, press: str) -> str:
        """Hash what a trial depends on: rows of other bundles and settings are not taken for its own."""
        edited = self.presses[press]
        picture = hashlib.sha256(edited.rgb.tobytes()).hexdigest()
        facts: list[object] = [FORMAT, self.bundle.digest, self.by, kind, *place, press]
        facts += [self.settings.spacing_mm, self.settings.seed, picture]
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:24]


@one_blas_thread()
def plan(
    bundle: Bundle,
    presses: NominalPresses,
    settings: Settings,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Plan:
    """Choose presses, judges and places. presses: cut to the bundle's region.

    Errors: DatasetError (presses of another sensor, too few of them, none with contact, no picture of the free gel),
    FitError where a fold cannot be fitted.
    """
    if presses.no_contact is None:
        raise DatasetError(
            f"{len(presses)} presses do not show the free gel; give a picture of it with --no-contact"
        )
    free = np.asarray(presses.no_contact.mean(axis=0, dtype=np.float64), np.float32)
    station = Station(bundle.profile, bundle.region, free)
    refused = tuple(
        name
        for name, rgb in zip(presses.names, presses.frames, strict=True)
        if refuses(bundle.manifest.colours, rgb)
    )
    _require_station(bundle, presses, refused)
    chosen, by = choose_judges(bundle, presses, settings.seed, settings.threads, progress)
    edited = {
        presses.names[k]: (EditedPress(station, presses.frames[k]), judge)
        for k, judge in chosen.items()
        if presses.names[k] not in refused
    }
    if not any(press.contact.any() for press, _ in edited.values()):
        raise DatasetError(
            f"none of the {len(edited)} presses touches the region {bundle.region}: no contact is seen against the "
            "picture of the free gel; give presses of this station, and its free gel with --no-contact"
        )
    kept, failing = _passing(bundle, edited, settings.presses)
    grid = PlaceGrid(station.field, settings.spacing_mm)
    places = touched_places(grid, [row.contact for row in kept.values()])
    if not places:
        raise DatasetError(
            f"the {len(kept)} presses touch no common place of the region {bundle.region}; press one position, or "
            "choose a larger --spacing"
        )
    judges = {name: edited[name][1] for name in kept}
    return Plan(bundle, settings, grid, kept, judges, places, by, failing, refused)


def run(
    planned: Plan,
    done: Mapping[str, Row],
    keep: Callable[[Row], None],
    advance: Callable[[int], None],
) -> list[Row]:
    """Try every place, press and kind, in this order. done: rows of an earlier run, by their key.

    keep: stores a row as soon as its trial is finished. advance: called with the trials done.
    """
    rows: list[Row] = []
    names = enumerate(planned.presses)
    cases = product(planned.places, names, planned.settings.kinds)
    for count, (place, (number, name), kind) in enumerate(cases, start=1):
        key = planned.key(kind, place, name)
        row = done.get(key)
        if row is None and (row := _trial(planned, kind, place, name, number)):
            row = {"key": key, **row}
            keep(row)
        rows += [row] if row else []
        advance(count)
    return rows


def _trial(planned: Plan, kind: str, place: Place, name: str, number: int) -> Row | None:
    """Search the smallest size at a spot of the place; None where the press does not touch it."""
    press = planned.presses[name]
    seed = [planned.settings.seed, tuple(KINDS).index(kind), *place, number]
    spot = planned.grid.spot(press.contact, place, np.random.default_rng(seed))
    if spot is None:
        return None
    low, high = planned.judges[name].bracket(press, kind, spot)
    return {
        "kind": kind,
        "place": list(place),
        "press": name,
        "spot": [spot.x_mm, spot.y_mm, spot.turn_rad],
        "low_mm": low,
        "high_mm": None if math.isinf(high) else high,
    }


def _require_station(bundle: Bundle, presses: NominalPresses, refused: Sequence[str]) -> None:
    """Check the sensor. Errors: DatasetError where its light is not known, or for presses of another one."""
    profile = bundle.profile
    seen = tuple(round(n * m, 1) for n, m in zip(profile.size, profile.mm_per_pixel, strict=True))
    if any(abs(found / crop - 1) > _CROP_TOLERANCE for found, crop in zip(seen, CROP_MM, strict=True)):
        raise DatasetError(
            f"the light of a GelSight Mini is known for its crop of {CROP_MM[0]:.1f} x {CROP_MM[1]:.1f} mm, and the "
            f"profile '{profile.name}' of bundle {bundle.where} shows {seen[0]} x {seen[1]} mm; fit with one of the "
            "profiles of that crop"
        )
    if len(presses) - len(refused) < MIN_PRESSES <= len(presses):
        raise DatasetError(
            f"{len(refused)} of {len(presses)} presses are of another sensor by their colours, the first "
            f"{refused[0]}; give presses of the station that bundle {bundle.where} was fitted on"
        )


def _passing(
    bundle: Bundle, edited: Mapping[str, tuple[EditedPress, Judge]], wanted: int
) -> tuple[dict[str, EditedPress], tuple[str, ...]]:
    """The first presses that pass without damage, as many as wanted, and the names of those before that do not.

    Errors: DatasetError where too few pass.
    """
    kept: dict[str, EditedPress] = {}
    failing: list[str] = []
    for name, (press, judge) in edited.items():
        if len(kept) == wanted:
            break
        with suppress(NotScorable):
            if judge.passes(press.rgb):
                kept[name] = press
                continue
        failing.append(name)
    if len(kept) < MIN_PRESSES:
        raise DatasetError(
            f"{len(failing)} of {len(edited)} presses fail without any damage, so {len(kept)} can be edited and "
            f"{MIN_PRESSES} are needed; bundle {bundle.where} does not know such presses: fit again"
        )
    return kept, tuple(failing)
