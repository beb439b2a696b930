"""Picture files: sizes without decoding, reading, and the list of everything that is wrong with a dataset."""

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DatasetError

__all__ = ["SUFFIXES", "Faults", "picture_size", "pictures_in", "pool_mask", "read_mask", "read_rgb"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")

# PNG specification, sections 5.2 and 11.2.2: signature, then IHDR with width and height; the file ends with IEND.
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"


class Faults:
    """Collects what is wrong, so that one error names every file and nobody repairs a dataset one run at a time."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._found: list[str] = []

    def add(self, path: Path, what: str) -> None:
        where = path.relative_to(self._root) if path.is_relative_to(self._root) else path
        self._found.append(f"{where.as_posix()}: {what}")

    def raise_any(self) -> None:
        """Errors: DatasetError listing all that was added, if anything was."""
        if self._found:
            count = len(self._found)
            listed = "\n  ".join(sorted(self._found))
            raise DatasetError(
                f"dataset '{self._root}' has {count} file{'s' * (count > 1)} at fault; repair or remove:\n  {listed}"
            )


def pictures_in(folder: Path, faults: Faults) -> dict[str, Path]:
    """File name to path of the pictures directly inside a folder, sorted; any other visible file is a fault."""
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.name.startswith("."):
            continue
        if path.suffix.lower() in SUFFIXES and path.is_file():
            found[path.name] = path
        else:
            faults.add(path, f"expected a picture ({', '.join(SUFFIXES)})")
    return found


def picture_size(path: Path) -> tuple[int, int] | None:
    """(width, height), or None when it cannot be read. A PNG is judged by its header and its end, not decoded."""
    try:
        with path.open("rb") as file:
            head = file.read(24)
            if head.startswith(_PNG_SIGNATURE):
                file.seek(-len(_PNG_END), 2)
                if len(head) < 24 or file.read() != _PNG_END:
                    return None
                width, height = struct.unpack(">II", head[16:24])
                return (width, height) if width and height else None
        picture = _decode(path, cv2.IMREAD_COLOR)
    except OSError:
        return None
    return None if picture is None else (picture.shape[1], picture.shape[0])


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """The picture, uint8 (h, w, 3), red green blue. Errors: DatasetError when it is not a whole picture."""
    bgr = _read(path, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.bool_]:
    """The mask at (width, height), bool (h, w): any non-zero pixel is a defect; a finer mask is max-pooled.

    Errors: DatasetError when it is unreadable or its size is no whole multiple of the wanted one.
    """
    raw = _read(path, cv2.IMREAD_UNCHANGED)
    colours = raw[..., :3] if raw.ndim == 3 else raw[..., None]
    try:
        return pool_mask(np.asarray(colours.any(axis=2), np.bool_), (size[1], size[0]))
    except ValueError as error:
        raise DatasetError(f"mask '{path}': {error}; export it at the size of its frame") from error


def pool_mask(mask: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Block-wise maximum of a mask, bool (h, w), down to `shape`: a block with any defect pixel is defective.

    A 1280x720 mask has 4x3 pixels per pixel of 320x240. Errors: ValueError unless the sizes are whole multiples.
    """
    (h, w), (rows, cols) = mask.shape, shape
    if h % rows or w % cols:
        raise ValueError(f"size {w}x{h} is no whole multiple of {cols}x{rows}")
    return np.asarray(mask.reshape(rows, h // rows, cols, w // cols).any(axis=(1, 3)), np.bool_)


def _read(path: Path, flags: int) -> NDArray[Any]:
    try:
        picture = _decode(path, flags)
    except OSError as error:
        raise DatasetError(f"picture '{path}' cannot be opened: {error.strerror}") from error
    if picture is None:
        raise DatasetError(f"picture '{path}' is truncated or not a picture; export it again")
    return picture


def _decode(path: Path, flags: int) -> NDArray[Any] | None:
    data = np.frombuffer(path.read_bytes(), np.uint8)
    return cv2.imdecode(data, flags) if data.size else None
