"""Real presses by sensor and object, as they lie in the folder of real tactile frames, and which of them are held out.

Which sensors are for development and which for judgement is in `calibration/experiments/backbones/sets.toml`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.experiments.backbones import touch_edits
from calibration.experiments.backbones.pictures import contact_square, read_picture, specks, together
from calibration.experiments.backbones.touch_edits import Edited
from calibration.experiments.backbones.trial import PROFILE, REGION, Trial
from calibration.fitting.damage.conditions import relight
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.simulator.field_of_view import F32
from edge.core.errors import DatasetError
from edge.core.imaging.region import Region

__all__ = [
    "ALPHA",
    "EDITS",
    "MIN_HELD",
    "OBJECTS",
    "Object",
    "Presses",
    "missing_sensors",
    "real_touch_trial",
    "trials_of",
]

U8 = NDArray[np.uint8]

MIN_HELD = 4
"""With fewer held-out presses their false alarms say nothing."""
# The film of a marker gel: frames of the free gel, then one long press, cut into blocks of ten. Every other block is
# learnt, and the middle of the others is held out, so that learnt and held-out frames are 0.16 s apart or more.
_FREE_FRAMES, _BLOCK = 20, 10
_LEARNT_FRAMES, _OTHER_FRAMES = range(92, 152), range(172, 202, 2)


@dataclass(frozen=True, eq=False)
class Presses:
    """Presses of one object in complete pictures, uint8 (240, 320, 3) each, and of another object if there is one."""

    learnt: Mapping[str, U8]
    held: Mapping[str, U8]
    free: U8
    others: Sequence[U8] = ()
    has_dots: bool = False


@dataclass(frozen=True)
class Object:
    """Presses of one object by one sensor."""

    name: str
    sensor: str
    """Its folder."""
    read: Callable[[Path], Presses]
    is_registered: bool = False
    """Cut around the contact."""
    marred: tuple[str, ...] = ()
    """Presses left out, seen by eye in the pictures."""


def _balls(folder: str, pattern: str, free: str, other: str, data: Path) -> Presses:
    """Presses of a ball, every third held out, and of another ball by the same sensor."""
    paths = _numbered(data / folder, pattern, free)
    pictures = {str(_number(path)): _landscape(path) for path in paths}
    held = set(list(pictures)[2::3])
    return Presses(
        {name: rgb for name, rgb in pictures.items() if name not in held},
        {name: rgb for name, rgb in pictures.items() if name in held},
        _landscape(data / folder / free),
        [_landscape(path) for path in _numbered(data / other, pattern, free)] if other else [],
    )


def _numbered(folder: Path, pattern: str, free: str) -> list[Path]:
    """The pictures of presses by their numbers. Errors: DatasetError for fewer than twelve."""
    found = sorted((path for path in folder.glob(pattern) if path.name != Path(free).name), key=_number)
    if len(found) < 3 * MIN_HELD:
        raise DatasetError(
            f"{folder} holds {len(found)} presses, at least {3 * MIN_HELD} are needed; fetch them again"
        )
    return found


def _number(path: Path) -> int:
    """Return the number of `12/gelsight.png`, `frame_12.jpg` or `0012.png`."""
    named = path.parent.name if path.stem == "gelsight" else path.stem
    return int(named.rpartition("_")[2])


def _landscape(path: Path) -> U8:
    """A picture of 320x240; an upright one is turned. Errors: DatasetError for another size."""
    rgb = read_picture(path)
    turned = np.ascontiguousarray(np.rot90(rgb)) if rgb.shape[0] > rgb.shape[1] else rgb
    if (turned.shape[1], turned.shape[0]) != PROFILE.size:
        raise DatasetError(f"'{path}' has {rgb.shape[1]}x{rgb.shape[0]} pixels, expected 320x240")
    return turned


def _film(data: Path) -> Presses:
    """A finger on a marker gel: blocks of one press learnt and held out; the edge of the finger is another object."""
    frames = _frames(data / "gelsightinc__gsrobotics" / "mini_example.avi")
    free = np.asarray(np.rint(np.mean(frames[:_FREE_FRAMES], axis=0)), np.uint8)
    place = [(number, *divmod(number - _LEARNT_FRAMES.start, _BLOCK)) for number in _LEARNT_FRAMES]
    return Presses(
        {f"{number}": frames[number] for number, block, _ in place if block % 2 == 0},
        {
            f"{number}": frames[number]
            for number, block, at in place
            if block % 2 and _BLOCK // 3 <= at <= 2 * _BLOCK // 3
        },
        free,
        [frames[number] for number in _OTHER_FRAMES],
        has_dots=True,
    )


def _frames(path: Path) -> list[U8]:
    """Every frame of a film. Errors: DatasetError."""
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    found = []
    while True:
        is_read, bgr = film.read()
        if not is_read:
            break
        found.append(np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8))
    film.release()
    if len(found) <= max(_OTHER_FRAMES):
        raise DatasetError(
            f"'{path}' gives {len(found)} frames, expected more than {max(_OTHER_FRAMES)}; fetch it again"
        )
    return found


def _ball_objects(
    name: str,
    sensor: str,
    folder: str,
    pattern: str,
    free: str,
    other: str = "",
    marred: tuple[str, ...] = (),
) -> list[Object]:
    """Return the same presses registered, and anywhere in complete pictures."""
    read = partial(_balls, f"{sensor}/{folder}", pattern, free, f"{sensor}/{other}" if other else "")
    return [
        Object(f"{name}, registered", sensor, read, True, marred),
        Object(f"{name}, anywhere", sensor, read),
    ]


_FOLDERS = "*/gelsight.png"

# A cut of the gel opens where it is pressed and does not show on the free gel. In registered presses it lies in these
# alone, at the left of 31 and 42 and in the contact of 8. On a fixture it would be in each press or in none.
OBJECTS = (
    *_ball_objects(
        "ball 6.31 mm",
        "rpl-cmu__gelslam",
        "6.310mm",
        _FOLDERS,
        "../background.png",
        "9.500mm",
        marred=("31", "42"),
    ),
    *_ball_objects(
        "ball 9.47 mm", "skleff1994__gs_sdk", "9.470mm", _FOLDERS, "../background.png", marred=("8",)
    ),
    Object("finger on a marker gel", "gelsightinc__gsrobotics", _film),
    *_ball_objects("ball 5.00 mm", "FabPrez__Taxim", "gsmini_ball5.0", "frame_*.jpg", "frame_0.jpg"),
    # Not registered: the ball is larger than a registered cut, and its light on the gel moves the contact's centre.
    _ball_objects(
        "ball 4.70 mm", "Rancho-zhao__FOTS", "gelsight_ball", "*.png", "../backgrounds/gelsight_bg.png"
    )[1],
)
"""Every object of both sets."""


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
    """Say why there are no trials: the sensors without a folder; empty when all are there."""
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
    relighted = [cut.region.crop(relight(cut.rgb, rng)) for cut in held]
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
                gather_presses({f"{k}": cut.rgb}, PROFILE, cut.region, no_contact=[free])
                for k, cut in enumerate(learnt)
            ]
        )
    return gather_presses(
        {f"{k}": cut.rgb for k, cut in enumerate(learnt)}, PROFILE, REGION, no_contact=[free]
    )


def _cuts(pictures: Sequence[U8], free: U8, is_registered: bool) -> list[_Cut]:
    """The presses whose contact lies in the region; registered ones without dirt of the free gel in their cut."""
    if not pictures:
        return []
    regions: list[Region | None] = [REGION] * len(pictures)
    if is_registered:
        named = {f"{k}": rgb for k, rgb in enumerate(pictures)}
        whole = gather_presses(named, PROFILE, Region.full(PROFILE.size), no_contact=[free])
        dirt = specks(free)
        squares = [contact_square(touch) for touch in whole.touches]
        regions = [None if one is None or one.crop(dirt).any() else one for one in squares]
    cuts = [_Cut(rgb, place) for rgb, place in zip(pictures, regions, strict=True) if place is not None]
    return [cut for cut in cuts if _spots(cut, free).sum() >= _MIN_TOUCHED_PX]


def _spots(cut: _Cut, free: U8) -> NDArray[np.bool_]:
    """Find where an edit's centre may lie, bool (240, 320): in the contact, away from the region's border."""
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
    """Find where a piece's centre may lie: in the contact, and not on a marker dot, which would hide it."""
    spots = _spots(cut, presses.free)
    return spots & ~touch_edits.near_dots(cut.rgb) if presses.has_dots else spots
