"""Trials from real pictures: presses of balls with rendered damage, foreign sensors, optical pictures of screws.

The folders are not part of the product; their pictures are only for evaluation, and nothing that ships is trained on
them.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.trial import PROFILE, REGION, Trial
from calibration.fitting.presses.nominal_presses import MAX_NO_CONTACT, NominalPresses, named_presses
from calibration.simulator import optics, sensor_appearance
from calibration.simulator.field_of_view import F32, LR, grids
from calibration.simulator.renderer import MASK_DEPTH_MM
from calibration.simulator.sensor_appearance import SENSORS
from edge.core.contact.mask import Touch
from edge.core.errors import DatasetError
from edge.core.imaging.region import Region

__all__ = [
    "BALLS",
    "REGISTERED_BALLS",
    "ball_trial",
    "contact_square",
    "read_picture",
    "registered_ball_trial",
    "screw_trial",
    "specks",
    "together",
]

U8 = NDArray[np.uint8]

# Folders of the real tactile frames: presses of one ball each, with a picture of the free gel.
BALLS = ("rpl-cmu__gelslam/6.310mm", "rpl-cmu__gelslam/9.500mm", "skleff1994__gs_sdk/9.470mm")
# Damage heights: presses at random places need more; on registered presses that damage is always found.
_HIGH_MM, _LOW_MM = (0.05, 0.12), (0.02, 0.06)
# Balls with enough presses far from the picture's edge for a cut around the contact.
REGISTERED_BALLS = (BALLS[0], BALLS[2])
# Side of such a cut: 6.1 mm, larger than the contact of these balls.
_SIDE_PX = 96
_DAMAGED_PLACES = 3
# Sum over the channels. Dirt on one of the two gels has 71, the grain of both at most 13 (measured).
_SPECK_LEVELS = 30
# Frames of other kinds of sensor.
_FOREIGN = ("RavenLiang1005__UniCal/[DT9]*/*.png", "Rancho-zhao__FOTS/digit_ball/000*.png")
_SEED = 0


def ball_trial(data: Path, ball: str) -> Trial:
    """Learnt presses of a ball, held-out ones, the same held-out ones with a rendered bump, and foreign frames.

    data: the folder of real tactile frames. Errors: DatasetError when the ball's presses are not in it.
    """
    pictures, background = _ball(data, ball)
    held = list(pictures)[2::3]
    sound = [pictures[name] for name in held]
    learnt = {name: rgb for name, rgb in pictures.items() if name not in held}
    rng = _rng(ball)
    edits = [_edited(rgb, background, REGION, _HIGH_MM, rng) for rgb in sound]
    foreign = [_resized(path) for pattern in _FOREIGN for path in sorted(data.glob(pattern))]
    shown = [*sound, *(rgb for rgb, _ in edits), *foreign]
    empty = np.zeros(sound[0].shape[:2], np.bool_)
    masks = [empty] * len(sound) + [mask for _, mask in edits] + [empty] * len(foreign)
    return Trial(
        _title(ball),
        named_presses(learnt, PROFILE, REGION, no_contact=[background]),
        np.stack([REGION.crop(rgb) for rgb in shown]),
        np.stack([REGION.crop(mask) for mask in masks]),
        np.arange(len(shown)) >= 2 * len(sound),
    )


def registered_ball_trial(data: Path, ball: str) -> Trial:
    """The same presses cut around their contacts, so the ball is always at one place, as on a fixture.

    Presses too near the picture's edge are left out, and those next to a speck on the free gel: on a fixture it would
    be at one place and be learnt. Every held-out press is damaged at three places. Errors: DatasetError as in
    `ball_trial`.
    """
    pictures, background = _ball(data, ball)
    whole = named_presses(pictures, PROFILE, Region(0, 0, *PROFILE.size), no_contact=[background])
    squares = [contact_square(touch) for touch in whole.touches]
    dirt = specks(background)
    kept = [
        (rgb, place)
        for rgb, place in zip(pictures.values(), squares, strict=True)
        if place is not None and not place.crop(dirt).any()
    ]
    held, rng = kept[2::3], _rng(ball)
    sound = [place.crop(rgb) for rgb, place in held]
    edits = [(*_edited(rgb, background, place, _LOW_MM, rng), place) for rgb, place in held * _DAMAGED_PLACES]
    masks = [place.crop(mask) for _, mask, place in edits]
    return Trial(
        _title(ball),
        together(
            [
                named_presses({f"{number}": rgb}, PROFILE, place, no_contact=[background])
                for number, (rgb, place) in enumerate(kept)
                if number % 3 != 2
            ]
        ),
        np.stack(sound + [place.crop(rgb) for rgb, _, place in edits]),
        np.stack([np.zeros_like(masks[0])] * len(sound) + masks),
        np.zeros(len(sound) + len(masks), np.bool_),
    )


def specks(background: U8) -> NDArray[np.bool_]:
    """Where the free gel differs from its surroundings of half a millimetre."""
    near, around = (cv2.GaussianBlur(background.astype(np.float32), (0, 0), sigma) for sigma in (1, 5))
    return np.asarray(np.abs(near - around).sum(axis=2) > _SPECK_LEVELS)


def together(presses: Sequence[NominalPresses]) -> NominalPresses:
    """Presses of one position, each cut at a different place, with the free gel there."""
    touched = [press.touched for press in presses if press.touched is not None]
    free = [press.no_contact for press in presses if press.no_contact is not None]
    return NominalPresses(
        np.concatenate([press.frames for press in presses]),
        tuple(name for press in presses for name in press.names),
        touched=np.logical_or.reduce(touched),
        no_contact=np.concatenate(free)[:MAX_NO_CONTACT],
    )


def _ball(data: Path, ball: str) -> tuple[dict[str, U8], U8]:
    """Presses by name in the order of their numbers, and the free gel."""
    files = sorted((data / ball).glob("*/gelsight.png"), key=lambda path: int(path.parent.name))
    if len(files) < 3:
        raise DatasetError(
            f"{data / ball} holds {len(files)} presses, at least 3 are needed; fetch them again"
        )
    background = read_picture((data / ball).parent / "background.png")
    return {path.parent.name: read_picture(path) for path in files}, background


def _title(ball: str) -> str:
    return f"ball {Path(ball).name}"


def _rng(ball: str) -> np.random.Generator:
    return np.random.default_rng([_SEED, int(Path(ball).name.replace(".", "").rstrip("m"))])


def contact_square(touch: Touch) -> Region | None:
    """The square around the centre of the touched area, None where it would leave the picture."""
    width, height = PROFILE.size
    x, y = round(touch.x * width) - _SIDE_PX // 2, round(touch.y * height) - _SIDE_PX // 2
    is_inside = 0 <= x <= width - _SIDE_PX and 0 <= y <= height - _SIDE_PX
    return Region(x, y, _SIDE_PX, _SIDE_PX) if is_inside else None


def screw_trial(data: Path) -> Trial:
    """Screws under a camera, complete pictures scaled to the region: sound ones learnt, sound and damaged ones scored.

    data: a folder in MVTec's layout, with masks. Errors: DatasetError when pictures or masks are missing.
    """
    learnt = sorted((data / "train" / "good").glob("*.png"))
    sound = sorted((data / "test" / "good").glob("*.png"))
    damaged = sorted(path for path in data.glob("test/*/*.png") if path.parent.name != "good")
    if not (learnt and sound and damaged):
        raise DatasetError(
            f"{data} holds no train/good, test/good or damaged test pictures; fetch them again"
        )
    side = (REGION.width, REGION.height)
    masks = [np.zeros(side[::-1], np.bool_)] * len(sound)
    for path in damaged:
        mask = read_picture(data / "ground_truth" / path.parent.name / f"{path.stem}_mask.png")[..., 0]
        masks.append(np.asarray(cv2.resize(mask, side, interpolation=cv2.INTER_AREA)) > 127)
    return Trial(
        "screws",
        NominalPresses(_scaled(learnt), tuple(path.name for path in learnt)),
        _scaled([*sound, *damaged]),
        np.stack(masks),
        np.zeros(len(masks), np.bool_),
    )


def _scaled(paths: Sequence[Path]) -> U8:
    side = (REGION.width, REGION.height)
    return np.stack(
        [
            np.asarray(cv2.resize(read_picture(path), side, interpolation=cv2.INTER_AREA), np.uint8)
            for path in paths
        ]
    )


def read_picture(path: Path) -> U8:
    """A picture as uint8 (h, w, 3) RGB. Errors: DatasetError."""
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise DatasetError(f"'{path}' is not a picture; fetch the real frames again")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def _resized(path: Path) -> U8:
    return np.asarray(cv2.resize(read_picture(path), PROFILE.size, interpolation=cv2.INTER_AREA), np.uint8)


def _edited(
    rgb: U8, background: U8, region: Region, high_mm: tuple[float, float], rng: np.random.Generator
) -> tuple[U8, NDArray[np.bool_]]:
    """A real press with a smooth bump or hollow of this height in the contact, lit with the sensor's response."""
    difference = np.abs(rgb.astype(np.float32) - background).sum(axis=2)
    touched = cv2.blur(difference, (9, 9)) > 30
    inside = np.zeros_like(touched)
    inside[region.y + 16 : region.y + region.height - 16, region.x + 16 : region.x + region.width - 16] = True
    spots = np.argwhere(touched & inside if (touched & inside).any() else inside)
    row, column = spots[rng.integers(len(spots))]
    x, y = grids(LR)
    r2 = (x - x[row, column]) ** 2 + (y - y[row, column]) ** 2
    radius, high = rng.uniform(0.3, 0.7), rng.uniform(*high_mm) * rng.choice([-1, 1])
    bump = np.asarray(high * np.exp(-0.5 * r2 / (radius / 2) ** 2), np.float32)
    unit = min(SENSORS.values(), key=lambda one: float(np.abs(_free(one) - background).mean()))
    nx, ny = optics.normals(bump, LR)
    free = sensor_appearance.background(unit, LR)
    lit = optics.illumination(
        nx, ny, free, sensor_appearance.response(unit, LR), unit.slope_response[:, 12:].astype(np.float32)
    )
    changed = rgb + (lit - free).transpose(1, 2, 0)
    return np.clip(np.round(changed), 0, 255).astype(np.uint8), np.abs(bump) > MASK_DEPTH_MM


def _free(unit: sensor_appearance.SensorAppearance) -> F32:
    planes: F32 = sensor_appearance.background(unit, LR)
    return planes.transpose(1, 2, 0)
