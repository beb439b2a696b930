"""Folder layouts: the paper's and MVTec's, each read into presses with all faults collected.

The paper's layout holds `rgb` (1280x720) and `rgb_320x240` per position, and the same under `fault` with `mask` and
`mask_320x240`. The low-resolution masks may be absent: they are then pooled from the high-resolution ones.
"""

from pathlib import Path
from typing import Literal

from calibration.dataset.files import Faults, pictures_in, size_of
from calibration.dataset.press import LabelledPress, parse_name

__all__ = [
    "SIZES",
    "Resolution",
    "is_mvtec",
    "is_paper",
    "positions",
    "read_mvtec",
    "read_paper",
    "resolution_of",
]

Resolution = Literal["lr", "hr"]

# The paper: low resolution 320x240, high resolution 1280x720.
SIZES: dict[Resolution, tuple[int, int]] = {"lr": (320, 240), "hr": (1280, 720)}
_SUFFIX: dict[Resolution, str] = {"lr": "_320x240", "hr": ""}


def resolution_of(size: tuple[int, int]) -> Resolution:
    """The resolution of the paper that fits pictures of this size."""
    return "hr" if size == SIZES["hr"] else "lr"


def is_paper(root: Path) -> bool:
    return any(True for _ in positions(root))


def positions(root: Path) -> list[Path]:
    """The `<part>/<position>` folders, sorted."""
    return sorted(
        {rgb.parent for name in ("rgb", "rgb_320x240") for rgb in root.glob(f"*/*/{name}") if rgb.is_dir()}
    )


def read_paper(root: Path, resolution: Resolution, faults: Faults) -> list[LabelledPress]:
    """The presses of every part and position at one resolution.

    A position with pictures of the other resolution only is left out (in the study PZ1 and PZ2 have no 1280x720). If no
    position has the resolution, every file is missing.
    """
    presses: list[LabelledPress] = []
    name = f"rgb{_SUFFIX[resolution]}"
    acquired = [f for f in positions(root) if (f / name).is_dir() or (f / "fault" / name).is_dir()]
    for folder in acquired or positions(root):
        presses += _frames(folder, folder, None, resolution, faults)
        if (folder / "fault").is_dir():
            presses += _frames(folder, folder / "fault", "fault", resolution, faults)
    return presses


def _frames(
    home: Path, folder: Path, defect: str | None, resolution: Resolution, faults: Faults
) -> list[LabelledPress]:
    part, position = home.parent.name, home.name
    frames_folder = folder / f"rgb{_SUFFIX[resolution]}"
    frames = pictures_in(frames_folder, faults)
    twin = folder / f"rgb{_SUFFIX['hr' if resolution == 'lr' else 'lr']}"
    if twin.is_dir() or not frames_folder.is_dir():
        for name in sorted(pictures_in(twin, Faults(folder)).keys() ^ frames.keys()):
            lacking = frames_folder if name not in frames else twin
            faults.add(lacking / name, "is missing; the other resolution has it")
    own = folder / f"mask{_SUFFIX[resolution]}"
    masks = pictures_in(own if own.is_dir() else folder / "mask", faults) if defect else {}
    presses = []
    for name, path in frames.items():
        specimen, number, is_misnamed = parse_name(path.stem, part, position)
        if is_misnamed:
            faults.add(path, f"is misnamed, expected {part}_{position}_s<specimen>_p<press>")
        mask_file = masks.pop(name, None)
        if _is_sound(path, SIZES[resolution], faults) and (
            defect is None or _has_mask(path, mask_file, SIZES[resolution], faults)
        ):
            presses.append(
                LabelledPress(path, part, position, SIZES[resolution], specimen, number, defect, mask_file)
            )
    for mask_file in masks.values():
        faults.add(mask_file, f"is a mask without a frame in {frames_folder.name}")
    return presses


def _is_sound(path: Path, expected: tuple[int, int], faults: Faults) -> bool:
    size = size_of(path)
    if size is None:
        faults.add(path, "is unreadable or truncated")
    elif size != expected:
        faults.add(path, f"is {size[0]}x{size[1]}, expected {expected[0]}x{expected[1]}")
    return size == expected


def _has_mask(path: Path, mask_file: Path | None, size: tuple[int, int], faults: Faults) -> bool:
    """Check that the mask exists, is readable, and is an integer multiple of the frame."""
    if mask_file is None:
        faults.add(path, "has no mask of the same name")
        return False
    mask_size = size_of(mask_file)
    if mask_size is None:
        faults.add(mask_file, "is unreadable or truncated")
    elif mask_size[0] % size[0] or mask_size[1] % size[1]:
        faults.add(
            mask_file,
            f"is {mask_size[0]}x{mask_size[1]}, expected {size[0]}x{size[1]} or an integer multiple",
        )
    else:
        return True
    return False


def is_mvtec(root: Path) -> bool:
    return bool(_categories(root))


def _categories(root: Path) -> list[Path]:
    folders = [root, *sorted(p for p in root.iterdir() if p.is_dir())] if root.is_dir() else []
    return [p for p in folders if (p / "train" / "good").is_dir() or (p / "test").is_dir()]


def read_mvtec(root: Path, faults: Faults) -> list[LabelledPress]:
    """The presses of MVTec-style categories: train/good, test/<defect>, ground_truth/<defect>/<name>_mask.png.

    The part is the category; the position is `train` or `test`, as the authors divided it.
    """
    presses: list[LabelledPress] = []
    for category in _categories(root):
        for folder in sorted(
            p for p in category.glob("t*/*") if p.is_dir() and p.parent.name in ("train", "test")
        ):
            presses += _category_frames(category, folder, faults)
    return presses


def _category_frames(category: Path, folder: Path, faults: Faults) -> list[LabelledPress]:
    defect = None if folder.name == "good" else folder.name
    masks = pictures_in(category / "ground_truth" / folder.name, faults) if defect else {}
    by_stem = {path.stem.removesuffix("_mask"): path for path in masks.values()}
    presses = []
    for path in pictures_in(folder, faults).values():
        size = size_of(path)
        mask_file = by_stem.pop(path.stem, None)
        if size is None:
            faults.add(path, "is unreadable or truncated")
        elif defect is None or _has_mask(path, mask_file, size, faults):
            specimen, number, _ = parse_name(path.stem, category.name, folder.parent.name)
            presses.append(
                LabelledPress(
                    path, category.name, folder.parent.name, size, specimen, number, defect, mask_file
                )
            )
    for mask_file in by_stem.values():
        faults.add(mask_file, f"is a mask without a frame in test/{folder.name}")
    return presses
