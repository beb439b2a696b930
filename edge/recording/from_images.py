"""A recording of presses and lifts, made from single press images.

Between presses the reference image, taken without contact, shows the lifted sensor. Motion, noise and residual imprint
are not invented. So the copies of a frame are identical, as from a hung camera, and a player refuses them as stale. The
label of every copy says that it is one. Two options make copies playable. `number_copies` writes a comment into the
file and changes no pixel; `noise` adds Gaussian noise of a given strength and seed and encodes the copy again.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edge.core.errors import DatasetError
from edge.core.imaging.image_bytes import damage, kind, picture_size, with_comment
from edge.core.imaging.quality import BLACK_LEVEL
from edge.recording.format import DELIVERED_SHARE, RecordingHeader, RecordingWriter, list_some
from edge.recording.from_video import VIDEO_SUFFIXES

__all__ = ["PressLift", "images_in", "record_images"]

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png"})


@dataclass(frozen=True)
class PressLift:
    """The timing of the sequence: frames per second, and the frames of a lift and of a press."""

    fps: float = 18.75
    lead_frames: int = 0
    """Additional frames of the first lift, in which a gateway learns the no-contact reference."""
    free_frames: int = 20
    press_frames: int = 12
    number_copies: bool = False
    noise_levels: float = 0.0
    """Standard deviation of Gaussian noise in copies, in grey levels."""
    noise_seed: int = 0
    """Makes it repeatable."""

    def __post_init__(self) -> None:
        if not 0 < self.fps < 1000 or min(self.free_frames, self.lead_frames) < 0 or self.press_frames < 1:
            raise ValueError(
                f"fps is positive, lead_frames and free_frames at least 0, press_frames at least 1, found {self}"
            )
        if not 0 <= self.noise_levels < 64:
            raise ValueError(
                f"noise has a standard deviation from 0 to below 64 grey levels, found {self.noise_levels}"
            )
        if self.noise_seed < 0:
            raise ValueError(f"the seed of the noise is 0 or more, found {self.noise_seed}")


@dataclass(frozen=True)
class _Shot:
    state: str
    press: int | None
    source: Path
    copies: int


def images_in(folder: Path, pattern: str = "**/*") -> list[Path]:
    """The JPEG and PNG files below a folder, numbers in their names in numerical order. Errors: DatasetError."""
    if not folder.is_dir():
        hint = "; a film is read with --from-video" if folder.suffix.lower() in VIDEO_SUFFIXES else ""
        raise DatasetError(f"{folder} is not a folder of press images{hint}")
    images = sorted(
        (path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()),
        key=lambda path: _natural(path.relative_to(folder).as_posix()),
    )
    if not images:
        raise DatasetError(f"{folder} has no JPEG or PNG file that matches '{pattern}'")
    return images


def record_images(
    out: Path,
    presses: Sequence[Path],
    reference: Path | None,
    plan: PressLift,
    *,
    product: str,
    serial: str,
    profile: str = "",
) -> int:
    """Write the recording and return its number of frames. Without a reference there are no lifts between presses.

    Errors: DatasetError naming every image that is damaged or of another size than the first.
    """
    mode = _common_size([*presses, *([reference] if reference else [])])
    header = RecordingHeader(product, serial, mode, nominal_fps=plan.fps / DELIVERED_SHARE, profile=profile)
    with RecordingWriter(out, header) as writer:
        for shot in _shots(presses, reference, plan):
            _add_shot(writer, shot, plan)
        return len(writer)


def _shots(presses: Sequence[Path], reference: Path | None, plan: PressLift) -> Iterator[_Shot]:
    """Lift, press, lift, press, ..., lift."""
    for number, press in enumerate(presses):
        if reference is not None:
            lead_frames = 0 if number else plan.lead_frames
            yield _Shot("free", None, reference, lead_frames + plan.free_frames)
        yield _Shot("press", number, press, plan.press_frames)
    if reference is not None:
        yield _Shot("free", None, reference, plan.free_frames)


def _add_shot(writer: RecordingWriter, shot: _Shot, plan: PressLift) -> None:
    original = shot.source.read_bytes()
    for copy in range(shot.copies):
        position = len(writer)
        label: dict[str, object] = {"state": shot.state, "source": shot.source.name, "copy": copy}
        if shot.press is not None:
            label["press"] = shot.press
        payload = original
        if copy and plan.noise_levels:
            payload = _with_noise(original, plan, position)
        elif copy and plan.number_copies:
            payload = with_comment(original, f"gelgate copy, frame {position}")
        writer.add(payload, round(position * 1e9 / plan.fps), label)


def _with_noise(original: bytes, plan: PressLift, position: int) -> bytes:
    """The picture with noise from seed and position, in the same file format, JPEG quality 95."""
    bgr = cv2.imdecode(np.frombuffer(original, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise DatasetError(f"an image of {len(original)} bytes cannot be decoded")
    grain = np.random.default_rng([plan.noise_seed, position]).normal(0.0, plan.noise_levels, bgr.shape)
    noisy = np.clip(np.rint(bgr.astype(np.float64) + grain), 0, 255).astype(np.uint8)
    suffix, how = (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 95]) if kind(original) == "jpg" else (".png", [])
    return cv2.imencode(suffix, noisy, how)[1].tobytes()


def _common_size(images: Sequence[Path]) -> tuple[int, int]:
    sizes: dict[Path, tuple[int, int]] = {}
    faults: list[str] = []
    for path in images:
        payload = path.read_bytes()
        size = picture_size(payload)
        fault = damage(payload) or (_darkness(payload) if size else "its size cannot be read")
        if fault or size is None:
            faults.append(f"{path} ({fault})")
        else:
            sizes[path] = size
    expected = next(iter(sizes.values()), (0, 0))
    faults += [
        f"{path} ({w}x{h}, not {expected[0]}x{expected[1]})"
        for path, (w, h) in sizes.items()
        if (w, h) != expected
    ]
    if faults:
        raise DatasetError(
            f"{len(faults)} of {len(images)} images cannot be in one recording: {list_some(faults)}"
        )
    return expected


def _darkness(payload: bytes) -> str | None:
    """Say why a picture does not show a lit sensor, or None; one that cannot be decoded is named elsewhere."""
    small = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_REDUCED_COLOR_8)
    if small is None or float(small.mean()) >= BLACK_LEVEL:
        return None
    return f"black: its mean level is {small.mean():.1f}, at least {BLACK_LEVEL:g} is expected"


def _natural(name: str) -> list[tuple[int, str]]:
    """press10 after press9."""
    parts = enumerate(re.split(r"(\d+)", name))
    return [(int(part), "") if i % 2 else (-1, part) for i, part in parts]
