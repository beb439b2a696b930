"""A small dataset in the paper's layout: a ring that every good press shows, and a hole in the defective ones."""

from pathlib import Path

import cv2
import numpy as np

PIECES = 8
PRESSES = 3


def press(rng: np.random.Generator, is_defective: bool) -> tuple[np.ndarray, np.ndarray]:
    """A picture of 320x240 and its mask: a ring around the middle, moved by a pixel or two."""
    x, y = 160 + rng.integers(-2, 3), 120 + rng.integers(-2, 3)
    picture = np.full((240, 320, 3), 110, np.uint8)
    cv2.circle(picture, (int(x), int(y)), 60, (190, 150, 90), 12)
    mask = np.zeros((240, 320), np.uint8)
    if is_defective:
        cv2.circle(mask, (int(x) + 60, int(y)), 9, 255, -1)
        picture[mask > 0] = 30
    noise = rng.normal(0, 3, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8), mask


def write(folder: Path, name: str, picture: np.ndarray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(folder / f"{name}.png"), picture)


def make_dataset(root: Path, *, pieces: int = PIECES, defective: int = 4, is_masked: bool = True) -> Path:
    """Good presses of `pieces` pieces, three each, and one press of each of `defective` other pieces."""
    rng = np.random.default_rng(0)
    place = root / "PZ9" / "pos1"
    (place / "rgb_320x240").mkdir(parents=True)
    for piece in range(1, pieces + 1):
        for number in range(1, PRESSES + 1):
            write(place / "rgb_320x240", f"PZ9_pos1_s{piece:03d}_p{number:02d}", press(rng, False)[0])
    for piece in range(pieces + 1, pieces + 1 + defective):
        picture, mask = press(rng, True)
        name = f"PZ9_pos1_s{piece:03d}_p01"
        write(place / "fault" / "rgb_320x240", name, picture)
        write(place / "fault" / "mask_320x240", name, mask if is_masked else np.zeros_like(mask))
    return root
