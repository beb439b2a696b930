"""Trials from real presses with small edits: the development set of real touch and its set of judgement.

The sensors of the two sets differ; which is which is in `calibration/benchmark/sets.toml`. The folders are not part of
the product.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark import touch_edits
from calibration.benchmark.pictures import contact_square, specks, together
from calibration.benchmark.touch_edits import Edited
from calibration.benchmark.touch_presses import MIN_HELD, OBJECTS, Object, Presses
from calibration.benchmark.trial import PROFILE, REGION, Trial
from calibration.fitting.nominal_presses import NominalPresses, named_presses
from calibration.rendered_damage.conditions import relit
from calibration.simulator.field_of_view import F32
from edge.core.errors import DatasetError
from edge.core.imaging.region import Region

__all__ = ["ALPHA", "EDITS", "missing_sensors", "real_touch_trial", "trials_of"]

U8 = NDArray[np.uint8]

ALPHA = 0.05
EDITS = 48
"""Edited presses of each trial; with fewer, differences of detection between backbones are chance."""
_SEED = 0
# Sum over the channels, and the share of the largest, which leaves out the glow around a contact. With fewer pixels the
# contact is outside the inspected region.
_TOUCHED_LEVELS, _TOUCHED_SHARE, _MIN_TOUCHED_PX = 30.0, 0.3, 150
# An edit's centre keeps this distance from the region's border: a detector sees the border cells less well.
_MARGIN_PX = 16


class _Cut(NamedTuple):
    """A complete picture and the region of it that is inspected."""

    rgb: U8
    region: Region

    @property
    def frame(self) -> U8:
        return np.asarray(self.region.crop(self.rgb), np.uint8)


def trials_of(data: Path, sensors: Sequence[str]) -> list[Callable[[], Trial]]:
    """The trials of these sensors. data: the folder of real tactile frames."""
    return [partial(real_touch_trial, data, found.name) for found in OBJECTS if found.sensor in sensors]


def missing_sensors(data: Path, sensors: Sequence[str]) -> str:
    """Why there are no trials: the sensors without a folder; empty when all are there."""
    absent = [sensor for sensor in sensors if not (data / sensor).is_dir()]
    return f"no frames of {', '.join(absent)} in the folder given with --tactile" if absent else ""


def real_touch_trial(data: Path, name: str, edits: int = EDITS) -> Trial:
    """Learnt presses, held-out ones, small edits of those, other objects, and the held-out ones under another light.

    Errors: DatasetError when the frames are not in the folder, or fewer than four held-out presses are in the region.
    """
    chosen = next(found for found in OBJECTS if found.name == name)
    presses = chosen.read(data)
    learnt, held, others = (
        _cuts(pictures, presses.free, chosen.is_registered)
        for pictures in (*(_unmarred(of, chosen) for of in (presses.learnt, presses.held)), presses.others)
    )
    if len(held) < MIN_HELD or len(learnt) < MIN_HELD:
        raise DatasetError(
            f"{name}: {len(learnt)} presses to learn and {len(held)} to hold out lie in the region, at least "
            f"{MIN_HELD} are needed; fetch the frames of {chosen.sensor} again"
        )
    rng = np.random.default_rng([_SEED, *name.encode()])
    damaged = _edits(held, edits, presses, rng)
    relighted = [cut.region.crop(relit(cut.rgb, rng)) for cut in held]
    counts = len(held) + len(damaged), len(others), len(relighted)
    frames = (
        [cut.frame for cut in held] + [rgb for rgb, _ in damaged] + [cut.frame for cut in others] + relighted
    )
    masks = np.zeros((len(frames), *frames[0].shape[:2]), np.bool_)
    masks[len(held) : counts[0]] = [mask for _, mask in damaged]
    kind = np.repeat([0, 1, 2], counts)
    return Trial(
        name,
        _nominal(learnt, presses.free, chosen.is_registered),
        np.stack(frames),
        masks,
        np.zeros(len(frames), np.bool_),
        is_other=kind == 1,
        is_relit=kind == 2,
        alpha=ALPHA,
    )


def _in_turn(held: Sequence[_Cut], count: int) -> list[_Cut]:
    """The held-out press that each edit is made of."""
    return [held[number % len(held)] for number in range(count)]


def _unmarred(pictures: Mapping[str, U8], chosen: Object) -> list[U8]:
    return [rgb for name, rgb in pictures.items() if name not in chosen.marred]


def _nominal(learnt: Sequence[_Cut], free: U8, is_registered: bool) -> NominalPresses:
    if is_registered:
        return together(
            [
                named_presses({f"{k}": cut.rgb}, PROFILE, cut.region, no_contact=[free])
                for k, cut in enumerate(learnt)
            ]
        )
    return named_presses(
        {f"{k}": cut.rgb for k, cut in enumerate(learnt)}, PROFILE, REGION, no_contact=[free]
    )


def _cuts(pictures: Sequence[U8], free: U8, is_registered: bool) -> list[_Cut]:
    """The presses whose contact lies in the region; registered ones without dirt of the free gel in their cut."""
    if not pictures:
        return []
    regions: list[Region | None] = [REGION] * len(pictures)
    if is_registered:
        named = {f"{k}": rgb for k, rgb in enumerate(pictures)}
        whole = named_presses(named, PROFILE, Region.full(PROFILE.size), no_contact=[free])
        dirt = specks(free)
        squares = [contact_square(touch) for touch in whole.touches]
        regions = [None if one is None or one.crop(dirt).any() else one for one in squares]
    cuts = [_Cut(rgb, place) for rgb, place in zip(pictures, regions, strict=True) if place is not None]
    return [cut for cut in cuts if _spots(cut, free).sum() >= _MIN_TOUCHED_PX]


def _spots(cut: _Cut, free: U8) -> NDArray[np.bool_]:
    """Where an edit's centre may lie, bool (240, 320): in the contact, away from the region's border."""
    levels = cv2.blur(np.abs(touch_edits.relief(cut.rgb, free)).sum(axis=2), (9, 9))
    touched = levels > max(_TOUCHED_LEVELS, _TOUCHED_SHARE * float(levels.max()))
    return np.asarray(touched & _inside(cut))


def _inside(cut: _Cut) -> NDArray[np.bool_]:
    """The region without its border, bool (240, 320)."""
    inside = np.zeros(cut.rgb.shape[:2], np.bool_)
    x, y, width, height = cut.region.x, cut.region.y, cut.region.width, cut.region.height
    inside[y + _MARGIN_PX : y + height - _MARGIN_PX, x + _MARGIN_PX : x + width - _MARGIN_PX] = True
    return inside


def _edits(
    held: Sequence[_Cut], count: int, presses: Presses, rng: np.random.Generator
) -> list[tuple[U8, NDArray[np.bool_]]]:
    """Edits of the held-out presses in turn and their masks, cut to the regions."""
    donors = [_donor(cut.rgb, presses) for cut in held]
    found = []
    for number, cut in enumerate(_in_turn(held, count)):
        at = number % len(held)
        # Every round over the presses begins one further, so that each press has edits of every kind.
        turn = (number + number // len(held)) % 4
        if presses.has_dots and turn % 2:
            edited = _dot_edit(cut, turn == 1, rng)
        else:
            others = [donor for k, donor in enumerate(donors) if k != at]
            edited = touch_edits.add_relief(cut.rgb, others, _relief_spots(cut, presses), rng)
        found.append((cut.region.crop(edited.rgb), cut.region.crop(edited.mask)))
    return found


def _donor(rgb: U8, presses: Presses) -> F32:
    """The relief of a press, without marker dots."""
    found = touch_edits.relief(rgb, presses.free)
    return touch_edits.between_dots(found, rgb, presses.free) if presses.has_dots else found


def _dot_edit(cut: _Cut, is_removed: bool, rng: np.random.Generator) -> Edited:
    """Dots are printed all over the gel, so the edit may lie outside the contact."""
    change = touch_edits.remove_dot if is_removed else touch_edits.add_dot
    return change(cut.rgb, _inside(cut), rng)


def _relief_spots(cut: _Cut, presses: Presses) -> NDArray[np.bool_]:
    """Where a piece's centre may lie: in the contact, and not on a marker dot, which would hide it."""
    spots = _spots(cut, presses.free)
    return spots & ~touch_edits.near_dots(cut.rgb) if presses.has_dots else spots
