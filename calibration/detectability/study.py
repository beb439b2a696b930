"""The study: every kind of damage, at every place of the contact, on several presses, as one row for each trial."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.detectability.free_gel import free_gel
from calibration.detectability.judges import MIN_PRESSES, panel
from calibration.detectability.places import Place, PlaceGrid, touched_places
from calibration.detectability.search import Judge
from calibration.fitting.colours import refuses
from calibration.fitting.nominal_presses import NominalPresses
from calibration.rendered_damage.damage import KINDS, Spot
from calibration.rendered_damage.imprint import Station
from calibration.rendered_damage.rendering import EditedPress
from calibration.simulator.constants import CROP_MM
from calibration.threads import one_blas_thread
from edge.core.errors import DatasetError, NotScorable
from edge.model.bundle import Bundle
from edge.model.detectability import JudgedBy

__all__ = ["Plan", "Settings", "Trial", "plan", "run"]

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


@dataclass(frozen=True)
class Trial:
    """One kind of damage at one spot of one press: the smallest size found is in (low_mm, high_mm]."""

    kind: str
    place: Place
    press: str
    spot: Spot
    low_mm: float
    high_mm: float

    def row(self, key: str) -> dict[str, Any]:
        """As it is stored; an infinite size is null."""
        return {
            "key": key,
            "kind": self.kind,
            "place": [self.place.row, self.place.column],
            "press": self.press,
            "spot": [self.spot.x_mm, self.spot.y_mm, self.spot.turn_rad],
            "low_mm": self.low_mm,
            "high_mm": None if math.isinf(self.high_mm) else self.high_mm,
        }

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> "Trial":
        high = math.inf if row["high_mm"] is None else row["high_mm"]
        return cls(row["kind"], Place(*row["place"]), row["press"], Spot(*row["spot"]), row["low_mm"], high)


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that a study needs, before its first trial.

    presses: to edit, by their names. judges: of each. false_alarms: names of presses that fail without damage; they
    are not edited. refused: names of presses of another sensor. warning: what is not known of the light.
    """

    bundle: Bundle
    settings: Settings
    grid: PlaceGrid
    presses: dict[str, EditedPress]
    judges: dict[str, Judge]
    places: tuple[Place, ...]
    by: JudgedBy
    false_alarms: tuple[str, ...]
    refused: tuple[str, ...]
    warning: str | None = None

    @property
    def total(self) -> int:
        """Trials at most: a press that does not touch a place has none there."""
        return len(self.settings.kinds) * len(self.places) * len(self.presses)

    def key(self, kind: str, place: Place, press: str) -> str:
        """What a trial depends on, as a short hash: rows of other bundles and settings are not taken for its own."""
        edited = self.presses[press]
        facts = [FORMAT, self.bundle.digest, self.by, kind, place.row, place.column, press]
        facts += [
            self.settings.spacing_mm,
            self.settings.seed,
            hashlib.sha256(edited.rgb.tobytes()).hexdigest(),
        ]
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
    free, warning = free_gel(bundle, presses)
    station = Station(bundle.profile, bundle.region, free)
    refused = tuple(
        name
        for name, rgb in zip(presses.names, presses.frames, strict=True)
        if refuses(bundle.manifest.colours, rgb)
    )
    _require_station(bundle, presses, refused)
    chosen = panel(bundle, presses, settings.seed, settings.threads, progress)
    edited = {
        presses.names[k]: (EditedPress(station, presses.frames[k]), judge)
        for k, judge in chosen.judges.items()
        if presses.names[k] not in refused
    }
    _require_contact(bundle, [press for press, _ in edited.values()])
    kept, failing = _passing(bundle, edited, settings.presses)
    grid = PlaceGrid(station.field, settings.spacing_mm)
    places = touched_places(grid, [one.contact for one in kept.values()])
    if not places:
        raise DatasetError(
            f"the {len(kept)} presses touch no common place of the region {bundle.region}; press one position, or "
            "choose a larger --spacing"
        )
    judges = {name: edited[name][1] for name in kept}
    return Plan(bundle, settings, grid, kept, judges, places, chosen.by, failing, refused, warning)


def run(
    planned: Plan,
    done: Mapping[str, Trial],
    keep: Callable[[dict[str, Any]], None],
    advance: Callable[[int], None],
) -> list[Trial]:
    """Every trial, in the order of places, presses and kinds. done: trials of an earlier run, by their key.

    keep: stores a row as soon as its trial is finished. advance: called with the trials done.
    """
    trials: list[Trial] = []
    count = 0
    for place in planned.places:
        for number, name in enumerate(planned.presses):
            for kind in planned.settings.kinds:
                key = planned.key(kind, place, name)
                trial = done.get(key) or _trial(planned, kind, place, name, number)
                if trial is not None:
                    if key not in done:
                        keep(trial.row(key))
                    trials.append(trial)
                count += 1
                advance(count)
    return trials


def _trial(planned: Plan, kind: str, place: Place, name: str, number: int) -> Trial | None:
    """None where the press does not touch the place."""
    press = planned.presses[name]
    seed = [planned.settings.seed, tuple(KINDS).index(kind), place.row, place.column, number]
    spot = planned.grid.spot(press.contact, place, np.random.default_rng(seed))
    if spot is None:
        return None
    low, high = planned.judges[name].bracket(press, kind, spot)
    return Trial(kind, place, name, spot, low, high)


def _passes(judge: Judge, press: EditedPress) -> bool:
    try:
        return judge.passes(press.rgb)
    except NotScorable:
        return False


def _require_station(bundle: Bundle, presses: NominalPresses, refused: Sequence[str]) -> None:
    """Errors: DatasetError for a sensor whose light is not known, or presses of another sensor."""
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


def _require_contact(bundle: Bundle, presses: Sequence[EditedPress]) -> None:
    """Errors: DatasetError where no press touches."""
    if not any(press.contact.any() for press in presses):
        raise DatasetError(
            f"none of the {len(presses)} presses touches the region {bundle.region}: no contact is seen against the "
            "picture of the free gel; give presses of this station, and its free gel with --no-contact"
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
        if _passes(judge, press):
            kept[name] = press
        else:
            failing.append(name)
    if len(kept) < MIN_PRESSES:
        raise DatasetError(
            f"{len(failing)} of {len(edited)} presses fail without any damage, so {len(kept)} can be edited and "
            f"{MIN_PRESSES} are needed; bundle {bundle.where} does not know such presses: fit again"
        )
    return kept, tuple(failing)
