"""Picture files: sizes without decoding, reading, and the list of everything that is wrong with a dataset."""

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import U8, Mask
from edge.core.errors import DatasetError, FrameCorrupt
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import damage, kind, picture_size
from edge.core.imaging.sensor_profile import SensorProfile, cut_to_aspect

__all__ = ["SUFFIXES", "Faults", "pictures_in", "pool_mask", "read_mask", "read_rgb", "size_of"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")

# PNG specification, sections 5.2 and 11.2.2: the size is in the first 24 bytes, the last chunk has 12.
_PNG_HEAD, _PNG_TAIL = 24, 12


class Faults:
    """Collects faults, so that one error names every file at fault."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._found: list[str] = []

    def add(self, path: Path, what: str) -> None:
        where = path.relative_to(self._root) if path.is_relative_to(self._root) else path
        self._found.append(f"{where.as_posix()}: {what}")

    def raise_any(self) -> None:
        """Raise DatasetError with all faults, if there are any."""
        if self._found:
            count = len(self._found)
            listed = "\n  ".join(sorted(self._found))
            raise DatasetError(
                f"dataset '{self._root}' has {count} file{'s' * (count > 1)} at fault; repair or remove:\n  {listed}"
            )


def pictures_in(folder: Path, faults: Faults) -> dict[str, Path]:
    """File name to path of the pictures directly inside a folder, sorted; any other visible file is a fault."""
    pictures: dict[str, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.name.startswith("."):
            continue
        if path.suffix.lower() in SUFFIXES and path.is_file():
            pictures[path.name] = path
        else:
            faults.add(path, f"expected a picture ({', '.join(SUFFIXES)})")
    return pictures


def size_of(path: Path) -> tuple[int, int] | None:
    """(width, height) of a complete picture, or None when it cannot be read. Of a PNG only the two ends are read."""
    try:
        with path.open("rb") as file:
            payload = file.read(_PNG_HEAD)
            if kind(payload) == "png":
                file.seek(-min(_PNG_TAIL, path.stat().st_size), os.SEEK_END)
            payload += file.read()
    except OSError:
        return None
    if kind(payload) is not None:
        size = None if damage(payload) else picture_size(payload)
        return size if size and all(size) else None
    pixels = _decode(payload, cv2.IMREAD_COLOR)
    return None if pixels is None else (pixels.shape[1], pixels.shape[0])


def read_rgb(path: Path, profile: SensorProfile | None = None, *, resize: bool = False) -> U8:
    """The picture, uint8 (h, w, 3), red green blue: in its own size, or as a profile shows it.

    With a profile, a picture of the camera's size is cropped and scaled by the profile, one of the profile's size is
    kept; resize crops any other to the profile's aspect, in the middle, and scales it. Errors: DatasetError with the
    file and its fault.
    """
    try:
        payload = _jpeg_or_png(path.read_bytes())
        size = picture_size(payload)
        if size is None or profile is None:
            profile = _as_it_is(size or (1, 1), size or (1, 1))
        elif size != profile.native:
            if size != profile.size and not resize:
                raise ValueError(_other_size(size, profile))
            profile = _as_it_is(size, profile.size, cut_to_aspect(size, profile.size))
        if (frame := CameraFrame(payload, 0, 0)).damage is not None:
            raise ValueError("ends early, or goes on after its end; copy it again, or save it anew")
        return decode(frame, profile)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be opened: {error.strerror}") from error
    except (FrameCorrupt, ValueError) as error:
        raise DatasetError(f"{path}: {error}") from error


def _as_it_is(
    native: tuple[int, int], size: tuple[int, int], border: tuple[float, float] = (0.0, 0.0)
) -> SensorProfile:
    """A profile for one picture: every picture gets the checks of a camera frame (complete, decodable)."""
    return SensorProfile("picture", native, border, size, 1, 1.0)


def _other_size(size: tuple[int, int], profile: SensorProfile) -> str:
    is_turned = size[::-1] in (profile.native, profile.size)
    what_to_do = "turn it by a quarter" if is_turned else "choose another profile, or allow resizing"
    return (
        f"is {size[0]}x{size[1]}, profile '{profile.name}' takes {profile.native[0]}x{profile.native[1]} (camera) "
        f"or {profile.size[0]}x{profile.size[1]}; {what_to_do}"
    )


def _jpeg_or_png(payload: bytes) -> bytes:
    """Convert to a format that a camera sends. Errors: ValueError for bytes that are not a picture."""
    if kind(payload) is not None:
        return payload
    pixels = _decode(payload, cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError("is not a picture that can be decoded, such as a JPEG or PNG")
    return cv2.imencode(".png", pixels)[1].tobytes()


def read_mask(path: Path, size: tuple[int, int]) -> Mask:
    """The mask at (width, height), bool (h, w): any non-zero pixel is a defect; a finer mask is max-pooled.

    Errors: DatasetError when it is unreadable or its size is not an integer multiple of the wanted one.
    """
    raw = _read(path, cv2.IMREAD_UNCHANGED)
    colours = raw[..., :3] if raw.ndim == 3 else raw[..., None]
    try:
        return pool_mask(np.asarray(colours.any(axis=2), np.bool_), (size[1], size[0]))
    except ValueError as error:
        raise DatasetError(f"mask '{path}': {error}; export it at the size of its frame") from error


def pool_mask(mask: Mask, shape: tuple[int, int]) -> Mask:
    """Block-wise maximum of a mask, bool (h, w), down to `shape`: a block with any defect pixel is defective.

    A 1280x720 mask has 4x3 pixels per pixel of 320x240. Errors: ValueError unless the sizes are integer multiples.
    """
    (h, w), (rows, cols) = mask.shape, shape
    if h % rows or w % cols:
        raise ValueError(f"size {w}x{h} is not an integer multiple of {cols}x{rows}")
    return np.asarray(mask.reshape(rows, h // rows, cols, w // cols).any(axis=(1, 3)), np.bool_)


def _read(path: Path, flags: int) -> NDArray[Any]:
    try:
        picture = _decode(path.read_bytes(), flags)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be opened: {error.strerror}") from error
    if picture is None:
        raise DatasetError(f"{path}: is truncated or not a picture; export it again")
    return picture


def _decode(payload: bytes, flags: int) -> NDArray[Any] | None:
    try:
        return cv2.imdecode(np.frombuffer(payload, np.uint8), flags) if payload else None
    except cv2.error:  # a size that is claimed and cannot be
        return None
