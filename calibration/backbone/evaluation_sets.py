"""What a backbone is judged on: presses of parts, damage and sensors that training never draws, and real frames.

Simulated sets come from the scenes of `calibration.scenes.paper` through the simulator's own renderer; training has
other parts, other damage and another renderer. Real sets are read from a folder that is no part of the product.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset import open_dataset
from calibration.presses import NominalPresses, read_presses
from calibration.scene import Defects, Nominal, Scene
from calibration.simulate import paper_scenes, simulate_dataset
from calibration.simulator import look, optics
from calibration.simulator.field import F32, LR, grids
from calibration.simulator.look import LOOKS
from calibration.simulator.renderer import MASK_DEPTH_MM, Renderer
from calibration.simulator.streams import named_streams
from edge.core.errors import DatasetError
from edge.core.profiles import profile
from edge.core.region import Region

__all__ = ["SCENE_SEED", "Trial", "real_trials", "simulated_trials"]

U8 = NDArray[np.uint8]

SCENE_SEED = 7001
UNSEEN_SENSOR = "unit_c"
# An effect that training does not draw; motion blur and JPEG, which it does not draw either, are in every scene.
UNSEEN_EFFECTS = ("partial_contact",)
# Six sound pieces are learnt, four are held out, four presses each; damaged pieces are others again.
_PIECES, _HELD_OUT, _PRESSES, _DAMAGED = 10, 4, 4, 16
_FREE_GELS = 4

_PROFILE = profile("cropped_lr")
_REGION = Region.centre(_PROFILE.size)


@dataclass(frozen=True)
class Trial:
    """One position of one part: what a detector learns, and what it then scores.

    frames: uint8 (n, h, w, 3). masks: bool (n, h, w), all False where nothing was done to the press. is_foreign: bool
    (n,), frames of another kind of sensor, which have no mask and count as neither sound nor damaged.
    """

    name: str
    nominal: NominalPresses
    frames: U8
    masks: NDArray[np.bool_]
    is_foreign: NDArray[np.bool_]


def simulated_trials(folder: Path, *, is_unseen_sensor: bool, parts: tuple[str, ...] = ()) -> Iterator[Trial]:
    """One trial per part analogue, at its first position. folder: where the pictures are written.

    is_unseen_sensor: the sensor and the effects that training never draws, instead of one that it varies.
    """
    for scene in paper_scenes():
        if parts and scene.part not in parts:
            continue
        small = _small(scene, is_unseen_sensor)
        root = folder / f"{scene.part}-{small.camera.sensor}"
        yield _trial(small, simulate_dataset(small, root, SCENE_SEED))


def _small(scene: Scene, is_unseen_sensor: bool) -> Scene:
    sensor = UNSEEN_SENSOR if is_unseen_sensor else "unit_b"
    more = UNSEEN_EFFECTS if is_unseen_sensor else ()
    return scene.model_copy(
        update={
            "positions": scene.at[:1],
            "camera": scene.camera.model_copy(update={"modes": ("lr",), "sensor": sensor}),
            "effects": (*scene.effects, *more),
            "nominal": Nominal(specimens=_PIECES, presses=_PRESSES),
            "defects": Defects(kinds=scene.defects.kinds, severity=scene.defects.severity, images=_DAMAGED),
        }
    )


def _trial(scene: Scene, root: Path) -> Trial:
    dataset = open_dataset(root, "lr").select(scene.part, scene.at[0])
    pieces = sorted({str(p.specimen) for p in dataset.good})
    learnt = [p.path for p in dataset.good if str(p.specimen) in pieces[: _PIECES - _HELD_OUT]]
    scored = [p for p in dataset.presses if p.path not in set(learnt)]
    gel = Renderer(
        LR, scene.effects, LOOKS[scene.camera.sensor], streams=named_streams(SCENE_SEED), session=scene.at[0]
    )
    free = []
    for number in range(_FREE_GELS):
        free.append(root.with_name(f"{root.name}-free-{number}.png"))
        _write_rgb(free[-1], gel.free_gel(("free", number)))
    return Trial(
        scene.part,
        read_presses(learnt, _PROFILE, _REGION, no_contact=free),
        np.stack([_REGION.crop(p.rgb()) for p in scored]),
        np.stack([_REGION.crop(p.mask()) for p in scored]),
        np.zeros(len(scored), np.bool_),
    )


def _write_rgb(path: Path, rgb: U8) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


def real_trials(data: Path, seed: int = 0) -> Iterator[Trial]:
    """Real presses of two balls: learnt ones, held-out ones, the same held-out ones with a bump rendered in, and frames
    of other kinds of sensor. data: the folder of real tactile frames. Nothing when it is not there.
    """
    home = data / "rpl-cmu__gelslam"
    strange = [
        _resized(path)
        for pattern in ("RavenLiang1005__UniCal/[DT9]*/*.png", "Rancho-zhao__FOTS/digit_ball/000*.png")
        for path in sorted(data.glob(pattern))
    ]
    for ball in ("6.310mm", "9.500mm"):
        files = sorted(home.glob(f"{ball}/*/gelsight.png"), key=lambda p: int(p.parent.name))
        if not files:
            continue
        rng = np.random.default_rng([seed, int(ball[0])])
        background = home / "background.png"
        held = files[2::3]
        learnt = [path for path in files if path not in held]
        sound = [_read_rgb(path) for path in held]
        edits = [_edited(rgb, _read_rgb(background), rng) for rgb in sound]
        pictures = [*sound, *(rgb for rgb, _ in edits), *strange]
        empty = np.zeros(sound[0].shape[:2], np.bool_)
        masks = [empty] * len(sound) + [mask for _, mask in edits] + [empty] * len(strange)
        yield Trial(
            f"ball {ball}",
            read_presses(learnt, _PROFILE, _REGION, no_contact=[background]),
            np.stack([_REGION.crop(rgb) for rgb in pictures]),
            np.stack([_REGION.crop(mask) for mask in masks]),
            np.arange(len(pictures)) >= 2 * len(sound),
        )


def _read_rgb(path: Path) -> U8:
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise DatasetError(f"'{path}' is not a picture; fetch the real frames again")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def _resized(path: Path) -> U8:
    return np.asarray(cv2.resize(_read_rgb(path), _PROFILE.size, interpolation=cv2.INTER_AREA), np.uint8)


def _edited(rgb: U8, background: U8, rng: np.random.Generator) -> tuple[U8, NDArray[np.bool_]]:
    """A real press with a smooth bump or hollow of 0.05 to 0.12 mm on what it touches, lit as the sensor answers."""
    difference = np.abs(rgb.astype(np.float32) - background).sum(axis=2)
    touched = cv2.blur(difference, (9, 9)) > 30
    inside = np.zeros_like(touched)
    inside[_REGION.y + 16 : _REGION.y + 208, _REGION.x + 16 : _REGION.x + 208] = True
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
