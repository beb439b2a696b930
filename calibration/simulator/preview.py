"""A contact sheet of a scene: sound presses, damaged presses with their masks, and its effects one by one."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from calibration.simulator.defects import Defect, place_defect
from calibration.simulator.effects import EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Pose, sample
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.scene import Scene
from calibration.simulator.streams import Streams
from edge.core.arrays import U8
from edge.pictures.image_file import encode

__all__ = ["preview", "title_picture", "write_preview"]

_COLUMNS = 6
_INK, _PAPER = (235, 235, 235), 24
# Changes are shown this many times larger, about mid grey.
_MAGNIFIED = 4
# An effect is shown on a gel that has been used.
_WORN = 600


def write_preview(scene: Scene, folder: Path, seed: int = 0) -> Path:
    """Write `<scene>_preview.png` into the folder and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{scene.name}_preview.png"
    path.write_bytes(encode(preview(scene, seed)))  # unlike cv2.imwrite, says why where it cannot
    return path


def preview(scene: Scene, seed: int = 0) -> U8:
    """The sheet, uint8 (h, w, 3) RGB, at 320x240 a picture whatever the scene's camera mode."""
    tiles = [*_sound(scene, seed), *_draw_damage(scene, seed)]
    blank = (np.full((*LR.shape, 3), _PAPER, dtype=np.uint8), "")
    tiles += [blank] * (-len(tiles) % _COLUMNS)
    tiles += _effects(scene, seed)
    tiles += [blank] * (-len(tiles) % _COLUMNS)
    pictures = [title_picture(picture, title) for picture, title in tiles]
    rows = [np.hstack(pictures[k : k + _COLUMNS]) for k in range(0, len(pictures), _COLUMNS)]
    return np.vstack(rows)


def _renderer(scene: Scene, seed: int, effects: tuple[str, ...] | None = None) -> Renderer:
    names = scene.effects if effects is None else effects
    return Renderer(LR, names, scene.camera.appearance, scene.press_jitter, Streams(seed))


def _sound(scene: Scene, seed: int) -> Iterator[tuple[U8, str]]:
    renderer = _renderer(scene, seed)
    yield renderer.free_gel(), "free gel"
    for position in scene.at:
        part = PARTS[scene.part].positions[position]
        for press in (1, 2):
            key = (scene.part, position, 1, press)
            yield renderer.press(part, scene.press_depth_mm, key), f"{scene.part} {position}, press {press}"


def _draw_damage(scene: Scene, seed: int) -> Iterator[tuple[U8, str]]:
    renderer, streams = _renderer(scene, seed), Streams(seed)
    part = PARTS[scene.part].positions[scene.at[0]]
    low, high = scene.defects.severity
    for kind in scene.defects.kinds:
        spot = place_defect(kind, high, part, scene.press_depth_mm, streams("preview", kind))
        for severity in (low, high):
            defect = Defect(kind, severity, spot.at_mm, spot.turn_rad, spot.size, spot.seed)
            rgb, mask = renderer.damage(
                part, defect, scene.press_depth_mm, (kind,), mask_depth_mm=scene.mask_depth_mm
            )
            outline, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            marked = np.asarray(cv2.drawContours(rgb.copy(), outline, -1, (255, 255, 255), 1), dtype=np.uint8)
            yield marked, f"{kind} {severity:.2f}, mask {int(mask.sum())} px"


def _effects(scene: Scene, seed: int) -> Iterator[tuple[U8, str]]:
    """Every effect of the scene added to the previous ones, and the change it makes; others are not computed."""
    names: tuple[str, ...] = ()
    before = _one(scene, seed, names)
    yield before, "no effect"
    yield np.full_like(before, 128), "no change"
    for name in (name for name in EFFECTS if name in scene.effects):
        names = (*names, name)
        after = _one(scene, seed, names)
        change = (after.astype(np.float32) - before) * _MAGNIFIED + 128
        yield after, f"+ {name}"
        yield np.clip(change, 0, 255).astype(np.uint8), f"change by {name}, x{_MAGNIFIED}"
        if name == "markers":
            # Dots would hide the later effects.
            names = names[:-1]
            after = _one(scene, seed, names)
        before = after


def _one(scene: Scene, seed: int, names: tuple[str, ...]) -> U8:
    renderer = _renderer(scene, seed, names)
    key = (scene.part, "preview")
    placed = renderer.place(Pose(), key)
    depth = scene.press_depth_mm * placed.depth_factor
    imprint = renderer.imprint(sample(PARTS[scene.part].positions[scene.at[0]], placed, LR), depth)
    # The previous press is shifted a little, so that its residual imprint is visible.
    previous = np.roll(imprint, 40, axis=1)
    surface = renderer.surface(imprint, _WORN, (previous, 0.5))
    return renderer.expose(renderer.light(surface, _WORN), key, Exposure(0, 5.0, (3.0, 2.0)))


def title_picture(picture: U8, title: str) -> U8:
    """Return the picture on paper, with its title above it."""
    tile = np.full((picture.shape[0] + 20, picture.shape[1] + 4, 3), _PAPER, dtype=np.uint8)
    tile[18:-2, 2:-2] = picture
    cv2.putText(tile, title, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, _INK, 1, cv2.LINE_AA)
    return tile
