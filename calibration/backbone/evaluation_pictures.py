"""Trials from pictures of real things: presses of balls with damage rendered in, foreign sensors, screws in the light.

The folders are no part of the product; their pictures are for judging alone and nothing is learnt from them that ships.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.backbone.evaluation_sets import PROFILE, REGION, Trial
from calibration.presses import NominalPresses, read_presses
from calibration.simulator import look, optics
from calibration.simulator.field import F32, LR, grids
from calibration.simulator.look import LOOKS
from calibration.simulator.renderer import MASK_DEPTH_MM
from edge.core.errors import DatasetError

__all__ = ["BALLS", "ball_trial", "screw_trial"]

U8 = NDArray[np.uint8]

# Presses of one ball each, with a picture of the free gel beside them: folders of the real tactile frames.
BALLS = ("rpl-cmu__gelslam/6.310mm", "rpl-cmu__gelslam/9.500mm", "skleff1994__gs_sdk/9.470mm")
# Frames of other kinds of sensor, which are no presses of this one.
_FOREIGN = ("RavenLiang1005__UniCal/[DT9]*/*.png", "Rancho-zhao__FOTS/digit_ball/000*.png")
_SEED = 0


def ball_trial(data: Path, ball: str) -> Trial:
    """Learnt presses of a ball, held-out ones, the same held-out ones with a bump rendered in, and foreign frames.

    data: the folder of real tactile frames. Errors: DatasetError when the ball's presses are not in it.
    """
    home, diameter = (data / ball).parent, Path(ball).name
    files = sorted((data / ball).glob("*/gelsight.png"), key=lambda path: int(path.parent.name))
    if len(files) < 3:
        raise DatasetError(
            f"{data / ball} holds {len(files)} presses, at least 3 are needed; fetch them again"
        )
    background = home / "background.png"
    held = files[2::3]
    rng = np.random.default_rng([_SEED, int(diameter.replace(".", "").rstrip("m"))])
    sound = [_read_rgb(path) for path in held]
    edits = [_edited(rgb, _read_rgb(background), rng) for rgb in sound]
    foreign = [_resized(path) for pattern in _FOREIGN for path in sorted(data.glob(pattern))]
    pictures = [*sound, *(rgb for rgb, _ in edits), *foreign]
    empty = np.zeros(sound[0].shape[:2], np.bool_)
    masks = [empty] * len(sound) + [mask for _, mask in edits] + [empty] * len(foreign)
    return Trial(
        f"ball {diameter}",
        read_presses([path for path in files if path not in held], PROFILE, REGION, no_contact=[background]),
        np.stack([REGION.crop(rgb) for rgb in pictures]),
        np.stack([REGION.crop(mask) for mask in masks]),
        np.arange(len(pictures)) >= 2 * len(sound),
    )


def screw_trial(data: Path) -> Trial:
    """Screws under a camera, whole pictures shrunk to the region: sound ones learnt, sound and damaged ones scored.

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
        mask = _read_rgb(data / "ground_truth" / path.parent.name / f"{path.stem}_mask.png")[..., 0]
        masks.append(np.asarray(cv2.resize(mask, side, interpolation=cv2.INTER_AREA)) > 127)
    return Trial(
        "screws",
        NominalPresses(_shrunk(learnt), tuple(path.name for path in learnt)),
        _shrunk([*sound, *damaged]),
        np.stack(masks),
        np.zeros(len(masks), np.bool_),
    )


def _shrunk(paths: Sequence[Path]) -> U8:
    side = (REGION.width, REGION.height)
    return np.stack(
        [
            np.asarray(cv2.resize(_read_rgb(path), side, interpolation=cv2.INTER_AREA), np.uint8)
            for path in paths
        ]
    )


def _read_rgb(path: Path) -> U8:
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise DatasetError(f"'{path}' is not a picture; fetch the real frames again")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def _resized(path: Path) -> U8:
    return np.asarray(cv2.resize(_read_rgb(path), PROFILE.size, interpolation=cv2.INTER_AREA), np.uint8)


def _edited(rgb: U8, background: U8, rng: np.random.Generator) -> tuple[U8, NDArray[np.bool_]]:
    """A real press with a smooth bump or hollow of 0.05 to 0.12 mm on what it touches, lit as the sensor answers."""
    difference = np.abs(rgb.astype(np.float32) - background).sum(axis=2)
    touched = cv2.blur(difference, (9, 9)) > 30
    inside = np.zeros_like(touched)
    inside[REGION.y + 16 : REGION.y + 208, REGION.x + 16 : REGION.x + 208] = True
    spots = np.argwhere(touched & inside if (touched & inside).any() else inside)
    row, column = spots[rng.integers(len(spots))]
    x, y = grids(LR)
    r2 = (x - x[row, column]) ** 2 + (y - y[row, column]) ** 2
    radius, high = rng.uniform(0.3, 0.7), rng.uniform(0.05, 0.12) * rng.choice([-1, 1])
    bump = np.asarray(high * np.exp(-0.5 * r2 / (radius / 2) ** 2), np.float32)
    unit = min(LOOKS.values(), key=lambda one: float(np.abs(_free(one) - background).mean()))
    nx, ny = optics.normals(bump, LR)
    free = look.background(unit, LR)
    lit = optics.illumination(
        nx, ny, free, look.response(unit, LR), unit.slope_response[:, 12:].astype(np.float32)
    )
    changed = rgb + (lit - free).transpose(1, 2, 0)
    return np.clip(np.round(changed), 0, 255).astype(np.uint8), np.abs(bump) > MASK_DEPTH_MM


def _free(unit: look.Look) -> F32:
    planes: F32 = look.background(unit, LR)
    return planes.transpose(1, 2, 0)
