"""Which free gel presses are compared with: the pictures that are given, or the estimate from the presses.

A picture that differs from the estimate is of another light only where presses lie apart: a gently curved part that
always lies at one place looks like light, and the estimate has it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.free_gel import MOST_PRESSES, FreeGel, estimate_free_gel, view_of
from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.reference import Reference
from edge.core.contact.relief import ReliefOfReference, with_relief
from edge.core.contact.settings import ContactSettings
from edge.core.contact.wear import foreign_free_gel
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = [
    "MIN_PRESSES",
    "SCATTERED_MM",
    "ChosenGel",
    "choose_free_gel",
    "contact_finder",
    "drop_foreign",
    "spread_mm",
]

U8 = NDArray[np.uint8]

MIN_PRESSES = 4
"""Presses that a threshold needs: a fold then keeps three. Of two or one there is no covariance and no spread between
presses, and the fold's scores have another scale than the bank's: with two presses PaDiM's threshold was 30 times the
nominal scores."""

SCATTERED_MM = 3.0
"""Presses whose contacts scatter more have no common place. Measured: up to 1.8 mm on simulated parts placed by hand,
where their contacts are wide and shallow; 4.2 mm and more on balls pressed anywhere, where methods that compare places
find a fifth of the damage that inreach finds."""


@dataclass(frozen=True, eq=False)
class ChosenGel:
    """The free gel that counts."""

    pictures: list[U8]
    """Whole pictures of it."""
    faults: list[str]
    """A sentence for each picture or press that does not belong, and for doubts."""
    estimated: str = ""
    """How it was estimated from the presses; empty where it was seen."""
    is_doubtful: bool = False


class Contact(NamedTuple):
    """Where a press touches, bool (120, 160), and the share of the view with an imprint's structure."""

    mask: NDArray[np.bool_]
    relief: float


def choose_free_gel(
    names: Sequence[str], pictures: Sequence[U8], given: Sequence[U8], profile: SensorProfile
) -> ChosenGel:
    """Choose the free gel of these presses, and name what does not belong."""
    kept = ChosenGel(list(given), [])
    if len(pictures) < MIN_PRESSES:
        return replace(kept, faults=_suspect(given, pictures))
    gel = estimate_free_gel(pictures)
    said = gel.find_strangers(names, pictures)
    if not given:
        return _of_estimate(
            gel, said, gel.doubt and "no contact is known by it; give a picture of it with --no-contact"
        )
    right, why = _divide(gel, given)
    if right and why:
        return ChosenGel(right, [*said, _left_out(given, right, why)])
    if not why:
        return replace(kept, faults=[*said, *(_suspect(given, pictures) if gel.doubt else [])])
    if _lie_apart(pictures, given, gel, profile):
        return _of_estimate(gel, said, f"{why}; take one under the light of the presses")
    said.append(
        f"{why}, or a part that always lies at one place; the picture is kept: look whether it is of the light of the "
        "presses"
    )
    return replace(kept, faults=said)


def drop_foreign(given: Sequence[U8], recorded: Sequence[U8]) -> tuple[list[U8], list[str]]:
    """Drop given pictures that are not of the light of the recorded free gel, and say so."""
    if not given or not recorded:
        return list(given), []
    mean = np.rint(np.mean(recorded, axis=0, dtype=np.float64)).astype(np.uint8)
    right, why = _divide(FreeGel(mean, np.zeros(VIEW_SIZE[::-1], np.bool_), 0), given)
    return right, [_left_out(given, right, why)] if why else []


def contact_finder(free: Sequence[U8]) -> Callable[[U8], Contact]:
    """Return the function that finds a picture's contact as the gateway does. free: one picture or more."""
    mean = np.stack([view_of(picture) for picture in free]).mean(axis=0, dtype=np.float64)
    reference = Reference(np.asarray(mean, np.float32))
    structure = ReliefOfReference(reference.view)

    def find(picture: U8) -> Contact:
        difference = reference.difference(view_of(picture))
        relief = structure.of(difference, ContactSettings.light_levels)
        mask = with_relief(touched_mask(difference), relief, ContactSettings.on_area)
        return Contact(mask, relief.area)

    for picture in free:  # from these it learns the noise: a part that fills the view has structure all over
        find(picture)
    return find


def spread_mm(touches: Sequence[Touch], profile: SensorProfile) -> float:
    """Measure how far half of the contacts lie from their common middle."""
    middles = np.array([(touch.x, touch.y) for touch in touches]) * profile.size / profile.pixels_per_mm
    return float(np.median(np.linalg.norm(middles - np.median(middles, axis=0), axis=1)))


def _divide(gel: FreeGel, given: Sequence[U8]) -> tuple[list[U8], str]:
    """Return the pictures that are not foreign, and why the first other is."""
    foreign = [gel.find_foreign(picture) for picture in given]
    right = [picture for picture, why in zip(given, foreign, strict=True) if not why]
    return right, next(filter(None, foreign), "")


def _left_out(given: Sequence[U8], right: Sequence[U8], why: str) -> str:
    return f"{len(given) - len(right)} of {len(given)} pictures of the free gel left out: {why}"


def _of_estimate(gel: FreeGel, said: list[str], why: str) -> ChosenGel:
    faults = [*said, f"the free gel is {gel}: {why}"] if why else said
    return ChosenGel([gel.picture], faults, str(gel), bool(gel.doubt))


def _lie_apart(pictures: Sequence[U8], given: Sequence[U8], gel: FreeGel, profile: SensorProfile) -> bool:
    """Tell whether contacts scatter, by the given pictures or by the estimate, where half of the presses have one."""
    rows = np.linspace(0, len(pictures) - 1, min(len(pictures), MOST_PRESSES)).round().astype(int)
    for free in (given, [gel.picture]):
        find = contact_finder(free)
        touches = [touched(find(pictures[k]).mask) for k in rows]
        touches = [touch for touch in touches if touch.area >= ContactSettings.on_area]
        if 2 * len(touches) >= len(rows) and spread_mm(touches, profile) > SCATTERED_MM:
            return True
    return False


def _suspect(given: Sequence[U8], pictures: Sequence[U8]) -> list[str]:
    """Warn where given pictures look foreign by the contacts alone, for want of an estimate."""
    if not given or not pictures:
        return []
    find = contact_finder(given)
    contacts = [find(picture) for picture in pictures]
    why = foreign_free_gel([touched(one.mask) for one in contacts], [one.relief for one in contacts])
    return [] if why is None else [f"{why}; a smooth part that always lies at one place looks the same"]
