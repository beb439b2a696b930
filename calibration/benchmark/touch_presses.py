"""Real presses by sensor and object, as they lie in the folder of real tactile frames, and which of them are held out.

Which sensors are for development and which for judgement is in `calibration/benchmark/sets.toml`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.pictures import read_picture
from calibration.benchmark.trial import PROFILE
from edge.core.errors import DatasetError

__all__ = ["MIN_HELD", "OBJECTS", "Object", "Presses"]

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
    """Presses of one object by one sensor.

    sensor: its folder. is_registered: cut around the contact. marred: presses left out, seen by eye in the pictures.
    """

    name: str
    sensor: str
    read: Callable[[Path], Presses]
    is_registered: bool = False
    marred: tuple[str, ...] = ()


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
    """Of `12/gelsight.png`, `frame_12.jpg` or `0012.png`."""
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
    """The same presses registered, and anywhere in complete pictures."""
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
