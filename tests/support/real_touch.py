"""Real presses by sensor and object, as they lie in the folder of real tactile frames, and which of them are held out.

The folders are not part of the product; their pictures are only for evaluation, and nothing that ships is trained on
them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import touch_edits
from touch_edits import Edited

from calibration.experiments.backbones.sets import PROFILE, REGION, EvaluationSet, Trial
from calibration.fitting.presses.nominal_presses import MAX_NO_CONTACT, NominalPresses, gather_presses
from edge.core.arrays import F32, U8, Mask
from edge.core.errors import DatasetError
from edge.core.imaging.region import Region

__all__ = [
    "EDITS",
    "MIN_HELD",
    "OBJECTS",
    "SENSORS",
    "Object",
    "Presses",
    "ball",
    "real_touch_sets",
    "real_touch_trial",
    "touch_trial",
]

SENSORS: Final[Mapping[str, Mapping[str, str]]] = {
    "real-touch": {
        "rpl-cmu__gelslam": "MIT, by its README",
        "skleff1994__gs_sdk": "GPL-3.0; measured, never trained on",
        "gelsightinc__gsrobotics": "GPL-3.0; measured, never trained on",
        "FabPrez__Taxim": "MIT",
        "Rancho-zhao__FOTS": "MIT, by its README",
    },
    "real-touch-judgement": {"Rancho-zhao__FOTS/digit_ball": "MIT, by its README"},
}
"""Of each set, the folder of each sensor with the licence of its frames. No sensor is in both.

Settings may be chosen on the first. The balls of 5.00 and 4.70 mm (FabPrez, Rancho-zhao) were for judgement until their
figures were among those by which the default trunk was chosen; the tables of docs/backbone.md still count them there.
On the second, a ball that lies anywhere on a DIGIT, no trunk and no setting was chosen: it is opened once, after every
choice. No marker gel is there."""

MIN_HELD = 4
"""With fewer held-out presses their scores say nothing."""
# The film of a marker gel: frames of the free gel, then one long press, cut into blocks of ten. Every other block is
# learnt, and the middle of the others is held out, so that learnt and held-out frames are 0.16 s apart or more.
_FREE_FRAMES, _BLOCK = 20, 10
_LEARNT_FRAMES = range(92, 152)


@dataclass(frozen=True, eq=False)
class Presses:
    """Presses of one object in complete pictures, uint8 (240, 320, 3) each."""

    learnt: Mapping[str, U8]
    held: Mapping[str, U8]
    free: U8
    has_dots: bool = False


@dataclass(frozen=True)
class Object:
    """Presses of one object by one sensor."""

    name: str
    sensor: str
    """Its folder."""
    read: Callable[[Path], Presses]
    """Reads them. Errors: DatasetError where they are not in the folder of all sensors."""
    is_registered: bool = False
    """Cut around the contact."""
    marred: tuple[str, ...] = ()
    """Presses left out, seen by eye in the pictures."""


def ball(name: str, sensor: str, paths: tuple[str, str, str], *marred: str) -> list[Object]:
    """Return the same presses of a ball registered, and anywhere in complete pictures. paths: folder, pattern of the
    presses, and the free gel."""
    folder, pattern, free = paths

    def read(data: Path) -> Presses:
        pictures = _numbered(data / sensor / folder, pattern, free)
        held = list(pictures)[2::3]
        return Presses(
            {name: rgb for name, rgb in pictures.items() if name not in held},
            {name: pictures[name] for name in held},
            _landscape(data / sensor / folder / free),
        )

    return [
        Object(f"{name}, registered", sensor, read, True, marred),
        Object(f"{name}, anywhere", sensor, read),
    ]


def _numbered(folder: Path, pattern: str, free: str) -> dict[str, U8]:
    """The pictures of presses by their numbers. Errors: DatasetError for fewer than twelve."""
    paths = {_number(path): path for path in folder.glob(pattern) if path.name != Path(free).name}
    if len(paths) < 3 * MIN_HELD:
        raise DatasetError(
            f"{folder} holds {len(paths)} presses, at least {3 * MIN_HELD} are needed; fetch them again"
        )
    return {str(number): _landscape(paths[number]) for number in sorted(paths)}


def _number(path: Path) -> int:
    """Return the number of `12/gelsight.png`, `frame_12.jpg` or `0012.png`."""
    named = path.parent.name if path.stem == "gelsight" else path.stem
    return int(named.rpartition("_")[2])


def _landscape(path: Path) -> U8:
    """A picture of 320x240; an upright one is turned. Errors: DatasetError for another size, or no picture."""
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise DatasetError(f"'{path}' is not a picture; fetch the real frames again")
    turned = np.ascontiguousarray(np.rot90(bgr)) if bgr.shape[0] > bgr.shape[1] else bgr
    if (turned.shape[1], turned.shape[0]) != PROFILE.size:
        raise DatasetError(f"'{path}' has {bgr.shape[1]}x{bgr.shape[0]} pixels, expected 320x240")
    return np.asarray(cv2.cvtColor(turned, cv2.COLOR_BGR2RGB), np.uint8)


def _film(data: Path) -> Presses:
    """A finger on a marker gel: blocks of one press learnt and held out."""
    path, frames = data / "gelsightinc__gsrobotics" / "mini_example.avi", list[U8]()
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    while (read := film.read())[0]:
        frames.append(np.asarray(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB), np.uint8))
    film.release()
    if len(frames) < _LEARNT_FRAMES.stop:
        raise DatasetError(
            f"'{path}' gives {len(frames)} frames, expected {_LEARNT_FRAMES.stop} or more; fetch it again"
        )
    place = [(number, *divmod(number - _LEARNT_FRAMES.start, _BLOCK)) for number in _LEARNT_FRAMES]
    held = [n for n, block, at in place if block % 2 and _BLOCK // 3 <= at <= 2 * _BLOCK // 3]
    return Presses(
        {f"{number}": frames[number] for number, block, _ in place if block % 2 == 0},
        {f"{number}": frames[number] for number in held},
        np.asarray(np.rint(np.mean(frames[:_FREE_FRAMES], axis=0)), np.uint8),
        has_dots=True,
    )


_FOLDERS = "*/gelsight.png", "../background.png"

# A cut of the gel opens where it is pressed and does not show on the free gel. In registered presses it lies in these
# alone, at the left of 31 and 42 and in the contact of 8. On a fixture it would be in each press or in none.
OBJECTS = (
    *ball("ball 6.31 mm", "rpl-cmu__gelslam", ("6.310mm", *_FOLDERS), "31", "42"),
    *ball("ball 9.47 mm", "skleff1994__gs_sdk", ("9.470mm", *_FOLDERS), "8"),
    Object("finger on a marker gel", "gelsightinc__gsrobotics", _film),
    *ball("ball 5.00 mm", "FabPrez__Taxim", ("gsmini_ball5.0", "frame_*.jpg", "frame_0.jpg")),
    # Not registered: the ball is larger than a registered cut, and its light on the gel moves the contact's centre.
    ball("ball 4.70 mm", "Rancho-zhao__FOTS", ("gelsight_ball", "*.png", "../backgrounds/gelsight_bg.png"))[
        1
    ],
    ball("ball on a DIGIT", "Rancho-zhao__FOTS/digit_ball", (".", "*.png", "../backgrounds/digit_bg.png"))[1],
)
"""Every object of both sets."""

EDITS = 48
"""Edited presses of each trial; with fewer, differences of detection between backbones are chance."""
_SEED = 0
# Sum over the channels, and the share of the largest, which leaves out the glow around a contact. With fewer pixels the
# contact is outside the inspected region.
_TOUCHED_LEVELS, _TOUCHED_SHARE, _MIN_TOUCHED_PX = 30.0, 0.3, 150
# An edit's centre keeps this distance from the region's border: a detector sees the border cells less well.
_MARGIN_PX = 16
# Side of a cut around a contact: 6.1 mm, larger than the contact of the balls.
_SIDE_PX = 96
# Sum over the channels. Dirt on one of the two gels has 71, the grain of both at most 13 (measured).
_SPECK_LEVELS = 30


class _Cut(NamedTuple):
    """A complete picture and the region of it that is inspected."""

    rgb: U8
    region: Region

    @property
    def frame(self) -> U8:
        return np.asarray(self.region.crop(self.rgb), np.uint8)

    @property
    def inside(self) -> Mask:
        """The region without its border, bool (240, 320)."""
        x, y, width, height = self.region.x, self.region.y, self.region.width, self.region.height
        inside = np.zeros(self.rgb.shape[:2], np.bool_)
        inside[y + _MARGIN_PX : y + height - _MARGIN_PX, x + _MARGIN_PX : x + width - _MARGIN_PX] = True
        return inside

    def contact(self, free: U8) -> Mask:
        """Find where it touches inside, bool (240, 320)."""
        levels = cv2.blur(np.abs(touch_edits.relief(self.rgb, free)).sum(axis=2), (9, 9))
        return np.asarray(levels > max(_TOUCHED_LEVELS, _TOUCHED_SHARE * float(levels.max()))) & self.inside


def real_touch_sets(data: Path, names: Sequence[str] = ("real-touch",)) -> dict[str, EvaluationSet]:
    """Return sets of trials of the folder of real tactile frames. Errors: DatasetError where sensors are missing."""
    found = {}
    for name in names:
        if absent := [sensor for sensor in SENSORS[name] if not (data / sensor).is_dir()]:
            raise DatasetError(f"no frames of {', '.join(absent)} in {data}")
        objects = [one.name for one in OBJECTS if one.sensor in SENSORS[name]]
        trials = tuple(partial(real_touch_trial, data, one) for one in objects)
        found[name] = EvaluationSet(f"Real touch: {name}", _TEXT, trials, is_brief=True)
    return found


_TEXT = (
    "Real presses with small edits, for no damaged part is public. A third of an object's presses is held out; edits "
    "of those are pieces of real relief of 10 to 20 pixels, shrunk, feathered, raised or sunk, and on the marker gel "
    "dots that are missing or added. Presses are anywhere in the picture, registered (cut around the contact), or of a "
    "film of one finger, whose frames are not independent. Registered presses in which a cut of the gel opens, as seen "
    "by eye, are left out."
)


def real_touch_trial(data: Path, name: str, edits: int = EDITS) -> Trial:
    """Learnt presses, held-out ones, and small edits of those. data: the folder of real tactile frames. Errors:
    DatasetError when the frames are not in it, or fewer than four held-out presses are in the region."""
    return touch_trial(data, next(found for found in OBJECTS if found.name == name), edits)


def touch_trial(data: Path, chosen: Object, edits: int = EDITS) -> Trial:
    """Make the trial of an object, which need not be one of a set. Arguments and errors as `real_touch_trial`."""
    name, presses = chosen.name, chosen.read(data)
    learnt, held = (
        _cuts([of[key] for key in of if key not in chosen.marred], presses.free, chosen.is_registered)
        for of in (presses.learnt, presses.held)
    )
    if len(held) < MIN_HELD or len(learnt) < MIN_HELD:
        raise DatasetError(
            f"{name}: {len(learnt)} presses to learn and {len(held)} to hold out lie in the region, at least "
            f"{MIN_HELD} are needed; fetch the frames of {chosen.sensor} again"
        )
    rng = np.random.default_rng([_SEED, *name.encode()])
    damaged = _edits(held, edits, presses, rng)
    frames = [*(cut.frame for cut in held), *(edit.rgb for edit in damaged)]
    masks = np.zeros((len(frames), *frames[0].shape[:2]), np.bool_)
    masks[len(held) :] = [edit.mask for edit in damaged]
    return Trial(name, _nominal(learnt, presses.free, chosen.is_registered), np.stack(frames), masks)


def _nominal(learnt: Sequence[_Cut], free: U8, is_registered: bool) -> NominalPresses:
    """Gather presses of one position; registered ones are each cut at a different place, with the free gel there."""
    if not is_registered:
        return gather_presses(
            {f"{k}": cut.rgb for k, cut in enumerate(learnt)}, PROFILE, REGION, no_contact=[free]
        )
    each = [
        gather_presses({f"{k}": c.rgb}, PROFILE, c.region, no_contact=[free]) for k, c in enumerate(learnt)
    ]
    return NominalPresses(
        np.concatenate([press.frames for press in each]),
        tuple(name for press in each for name in press.names),
        touched=np.logical_or.reduce([press.touched for press in each if press.touched is not None]),
        no_contact=np.concatenate([p.no_contact for p in each if p.no_contact is not None])[:MAX_NO_CONTACT],
    )


def _cuts(pictures: Sequence[U8], free: U8, is_registered: bool) -> list[_Cut]:
    """The presses whose contact lies in the region; registered ones without dirt of the free gel in their cut."""
    regions: Sequence[Region | None] = [REGION] * len(pictures)
    if is_registered and pictures:
        named = {f"{k}": rgb for k, rgb in enumerate(pictures)}
        whole = gather_presses(named, PROFILE, Region.full(PROFILE.size), no_contact=[free])
        # Dirt differs from its surroundings of half a millimetre.
        near, around = (cv2.GaussianBlur(free.astype(np.float32), (0, 0), sigma) for sigma in (1, 5))
        dirt = np.abs(near - around).sum(axis=2) > _SPECK_LEVELS
        regions = [_square(touch.x, touch.y, dirt) for touch in whole.touches]
    cuts = [_Cut(rgb, place) for rgb, place in zip(pictures, regions, strict=True) if place is not None]
    return [cut for cut in cuts if cut.contact(free).sum() >= _MIN_TOUCHED_PX]


def _square(across: float, down: float, dirt: Mask) -> Region | None:
    """The square around a contact's centre, in shares of the picture; None outside the picture, or with dirt in it."""
    width, height = PROFILE.size
    x, y = round(across * width) - _SIDE_PX // 2, round(down * height) - _SIDE_PX // 2
    if not (0 <= x <= width - _SIDE_PX and 0 <= y <= height - _SIDE_PX):
        return None
    square = Region(x, y, _SIDE_PX, _SIDE_PX)
    return None if square.crop(dirt).any() else square


def _edits(held: Sequence[_Cut], count: int, presses: Presses, rng: np.random.Generator) -> list[Edited]:
    """Edits of the held-out presses in turn and their masks, cut to the regions."""
    donors = [_donor(cut.rgb, presses) for cut in held]
    found = []
    for number in range(count):
        at = number % len(held)
        cut = held[at]
        # Every round over the presses begins one further, so that each press has edits of every kind.
        turn = (number + number // len(held)) % 4
        if presses.has_dots and turn % 2:
            # Dots are printed all over the gel, so the edit may lie outside the contact.
            change = touch_edits.remove_dot if turn == 1 else touch_edits.add_dot
            edited = change(cut.rgb, cut.inside, rng)
        else:
            spots = cut.contact(presses.free)
            if presses.has_dots:  # a dot would hide the piece
                spots &= ~touch_edits.near_dots(cut.rgb)
            edited = touch_edits.add_relief(cut.rgb, donors[:at] + donors[at + 1 :], spots, rng)
        found.append(Edited(cut.region.crop(edited.rgb), cut.region.crop(edited.mask)))
    return found


def _donor(rgb: U8, presses: Presses) -> F32:
    """The relief of a press, without marker dots."""
    found = touch_edits.relief(rgb, presses.free)
    return touch_edits.between_dots(found, rgb, presses.free) if presses.has_dots else found
