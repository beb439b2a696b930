"""Which free gel presses are compared with: the pictures that are given, or the estimate from the presses.

A picture that differs from the estimate is of another light only where presses lie apart: a gently curved part that
always lies at one place looks like light, and the estimate has it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.fitting.presses.colours import CELLS
from calibration.fitting.presses.free_gel import MOST_PRESSES, FreeGel, estimate_free_gel, view_of
from edge.core.arrays import F64, U8, Mask
from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.reference import Reference
from edge.core.contact.relief import ReliefOfReference, with_relief
from edge.core.contact.settings import ContactSettings
from edge.core.contact.wear import foreign_free_gel
from edge.core.imaging.sensor_check import colour_cells, colour_distance
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.printable import write_count

__all__ = ["MIN_PRESSES", "SCATTERED_MM", "away_mm", "choose_free_gel", "contact_finder", "spread_mm"]

MIN_PRESSES = 4
"""Presses that a threshold needs: a fold then keeps three. Of two or one there is no covariance and no spread between
presses, and the fold's scores have another scale than the bank's: with two presses PaDiM's threshold was 30 times the
nominal scores."""

SCATTERED_MM = 3.0
"""Presses whose contacts scatter more have no common place. Measured: up to 1.8 mm on simulated parts placed by hand,
where their contacts are wide and shallow; 4.2 mm and more on balls pressed anywhere, where methods that compare places
find a fifth of the damage that inreach finds."""

# Of the light, between the free gel and the mean press by coarse colours: right pictures differ by 0.8 to 7.2 % on 14
# sets, those of other units by 2 to 14 %, of other sensors by 39 % and more.
_FOREIGN_COLOURS = 0.1


@dataclass(frozen=True, eq=False)
class ChosenGel:
    """The free gel that counts."""

    pictures: list[U8]
    """Whole pictures of it."""
    faults: list[str]
    """A sentence for pictures of it that do not belong, and for doubts."""
    estimated: str = ""
    """How it was estimated from the presses; empty where it was seen."""
    is_doubtful: bool = False


class Contact(NamedTuple):
    """Where a press touches, bool (120, 160), and the share of the view with an imprint's structure."""

    mask: Mask
    relief: float


def choose_free_gel(
    pictures: Sequence[U8], given: Mapping[str, U8], recorded: Sequence[U8], profile: SensorProfile
) -> ChosenGel:
    """Choose the free gel of presses, pictures and recordings together.

    pictures: of presses. given: pictures of it, by their names. recorded: frames of it, of recordings.
    """
    gel = estimate_free_gel(pictures, profile.pixels_per_mm) if len(pictures) >= MIN_PRESSES else None
    if recorded:
        return _of_recordings(gel, given, recorded)
    if gel is None:
        doubts = _suspect(given, pictures)
        if given and pictures and not doubts:
            light = "whether the picture of the free gel is of the light of the presses"
            few = f"cannot be checked with {write_count(len(pictures), 'press')}"
            doubts = [f"{light} {few}: look at it, or give at least {MIN_PRESSES}"]
        return ChosenGel(list(given.values()), doubts)
    pressed = [name for name, picture in given.items() if gel.shows_part(picture)]
    chosen = _choose(gel, {name: given[name] for name in given if name not in pressed}, pictures, profile)
    return replace(chosen, faults=[*_name_pressed(pressed), *chosen.faults])


def _choose(
    gel: FreeGel, given: Mapping[str, U8], pictures: Sequence[U8], profile: SensorProfile
) -> ChosenGel:
    """Choose between the estimate and given pictures of it."""
    kept = ChosenGel(list(given.values()), [])
    if not given:
        known = "contacts may be larger than" if gel.shows_contacts else "no contact is"
        found = _of_estimate(
            gel, gel.doubt and f"{known} known by it; give a picture of it with --no-contact"
        )
        if _lie_apart(pictures, [gel.picture], gel, profile):
            return found
        return replace(
            found, estimated=f"{found.estimated}; what is smooth and always at one place counts as gel"
        )
    right, why = _divide(gel, given)
    if right and why:
        return ChosenGel(right, [f"{why}; left out"])
    if not why:
        return replace(kept, faults=_suspect(given, pictures) if gel.doubt else [])
    if _lie_apart(pictures, kept.pictures, gel, profile):
        return _of_estimate(gel, f"{why}; take one under the light of the presses, with nothing on the gel")
    why += ", or a part that always lies at one place; kept: look whether it is of the light of the presses"
    return replace(kept, faults=[why])


def _name_pressed(names: Sequence[str]) -> list[str]:
    if not names:
        return []
    quoted = ", ".join(f"'{name}'" for name in names)
    return [
        f"pictures of the free gel ({quoted}) show the part, and are left out; take one with nothing on the gel"
    ]


def _of_recordings(gel: FreeGel | None, given: Mapping[str, U8], recorded: Sequence[U8]) -> ChosenGel:
    """Take the free gel that recordings show, with those given pictures that are of its light."""
    seen = FreeGel.of(recorded)
    right, why = _divide(seen, given)
    faults = [f"{why}; left out"] if why else []
    if gel is not None and (why := gel.find_foreign(seen.picture)):
        faults.append(
            f"beside the presses of the pictures, the free gel of the recordings {why}, or these show a part that "
            "always lies at one place; where they are of two sensors, gels or lights, fit each alone"
        )
    return ChosenGel([*right, *recorded], faults)


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
    return float(np.median(away_mm(touches, profile)))


def away_mm(touches: Sequence[Touch], profile: SensorProfile) -> F64:
    """Measure how far each contact lies from their common middle, (n,)."""
    middles = np.array([(touch.x, touch.y) for touch in touches]) * profile.size / profile.pixels_per_mm
    return np.asarray(np.linalg.norm(middles - np.median(middles, axis=0), axis=1))


def _divide(gel: FreeGel, given: Mapping[str, U8]) -> tuple[list[U8], str]:
    """Return the pictures that are not foreign, and name the others, with how the first differs."""
    foreign = {name: why for name, picture in given.items() if (why := gel.find_foreign(picture))}
    right = [picture for name, picture in given.items() if name not in foreign]
    if not foreign:
        return right, ""
    names = ", ".join(f"'{name}'" for name in foreign)
    count = f"{len(foreign)} of {len(given)} pictures" if len(given) > 1 else "the picture"
    first = ": the first" if len(foreign) > 1 else ""
    return right, f"{count} of the free gel ({names}){first} {next(iter(foreign.values()))}"


def _of_estimate(gel: FreeGel, why: str) -> ChosenGel:
    faults = [f"the free gel is {gel}: {why}"] if why else []
    return ChosenGel([gel.picture], faults, str(gel), not gel.shows_contacts)


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


def _suspect(given: Mapping[str, U8], pictures: Sequence[U8]) -> list[str]:
    """Warn where given pictures look foreign by contacts and coarse colours alone, for want of an estimate."""
    if not given or not pictures:
        return []
    find = contact_finder(list(given.values()))
    contacts = [find(picture) for picture in pictures]
    why = foreign_free_gel(
        [touched(contact.mask) for contact in contacts], [contact.relief for contact in contacts]
    )
    sentences = [] if why is None else [why]
    press = colour_cells(np.rint(np.mean(pictures, axis=0)).astype(np.uint8), CELLS)
    away = {name: colour_distance(colour_cells(picture, CELLS), press) for name, picture in given.items()}
    sentences += [
        f"the picture of the free gel '{name}' differs by {share:.0%} of the light from the colours of the presses: "
        "another light, gel or sensor; take one under the light of the presses"
        for name, share in away.items()
        if share > _FOREIGN_COLOURS
    ]
    return [
        f"{sentence}; a smooth part that always lies at one place looks the same" for sentence in sentences
    ]
