"""A dataset of made pictures in the paper's layout, small enough for studies in tests."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from study_cells import quiet

from calibration.experiments.harness.study import Options

LR, HR = (320, 240), (1280, 720)


def study_dataset(root: Path, part: str = "PZ3", positions: tuple[str, ...] = ("pos1", "pos2")) -> Path:
    """Per position 8 nominal presses of 4 specimens and 2 damaged ones, each position with a relief of its own. The
    first position has both resolutions, the others only 320x240. Damage is a bright square."""
    for index, position in enumerate(positions):
        relief = _relief(index)
        for specimen in range(1, 7):
            for press in (1, 2) if specimen < 5 else (1,):
                name = f"{part}_{position}_s{specimen:03d}_p{press:02d}.png"
                noise = np.random.default_rng((index, specimen, press)).normal(0, 2, (*HR[::-1], 3))
                picture, mask = relief + noise, np.zeros(HR[::-1], np.uint8)
                home = root / part / position
                if specimen > 4:
                    home /= "fault"
                    corner = 200 + 60 * specimen
                    mask[corner : corner + 90, corner : corner + 120] = 255
                    picture[mask > 0] += 60
                _write(home, name, picture, mask if specimen > 4 else None, is_fine=index == 0)
    return root


def options(dataset: Path, output: Path, **changed: Any) -> Options:
    """Return the options of a small study."""
    asked: dict[str, Any] = {
        "methods": ("subspace",),
        "seeds": 2,
        "held_out": 2,
        "fraction": 1.0,
        "show": quiet,
    }
    return Options(dataset=dataset, output=output, **(asked | changed))


def _relief(seed: int) -> NDArray[np.float64]:
    coarse = np.random.default_rng(seed).uniform(60, 170, (9, 16, 3))
    return np.asarray(cv2.resize(coarse, HR, interpolation=cv2.INTER_CUBIC), np.float64)


def _write(
    home: Path, name: str, picture: NDArray[np.float64], mask: NDArray[np.uint8] | None, *, is_fine: bool
) -> None:
    fine = np.clip(picture, 0, 255).astype(np.uint8)
    files = {"rgb_320x240": cv2.resize(fine, LR, interpolation=cv2.INTER_AREA)}
    if is_fine:
        files["rgb"] = fine
    if mask is not None:
        files["mask_320x240"] = mask.reshape(240, 3, 320, 4).max(axis=(1, 3))
        if is_fine:
            files["mask"] = mask
    for folder, pixels in files.items():
        (home / folder).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(home / folder / name), pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
