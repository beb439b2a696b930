"""One press of a dataset, its mask, how presses are divided by specimen, and what is said of likely mistakes.

Annotated shapes have continuous coordinates; the top left corner of the top left pixel is (0, 0), as in CVAT. A pixel
belongs to a shape when its centre is inside.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.dataset.files import read_mask, read_rgb
from edge.core.arrays import F64, U8, Mask
from edge.core.errors import DatasetError

__all__ = [
    "LabelledPress",
    "Polygon",
    "Runs",
    "Shape",
    "Split",
    "empty_masks",
    "numbered",
    "parse_name",
    "rasterise",
    "repeated_pictures",
    "split_by_specimen",
]


@dataclass(frozen=True)
class Polygon:
    """A closed outline; points are (x, y) in pixels. Boxes are polygons of four points."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 3:
            raise ValueError(f"a polygon needs three points, found {len(self.points)}")
        if not np.isfinite(self.points).all():
            raise ValueError("a polygon's points are finite numbers")


@dataclass(frozen=True)
class Runs:
    """A run-length mask in a rectangle: counts alternate good, defect, ... in row order, starting with good."""

    left: int
    top: int
    width: int
    height: int
    counts: tuple[int, ...]

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 1 or min(self.counts, default=-1) < 0:
            raise ValueError("a run-length mask has a positive size and no negative run")
        if sum(self.counts) != self.width * self.height:
            raise ValueError(f"runs sum to {sum(self.counts)}, expected {self.width}x{self.height} pixels")


Shape = Polygon | Runs


def rasterise(shapes: Sequence[Shape], size: tuple[int, int]) -> Mask:
    """The union of the shapes, bool (h, w), for a picture of (width, height); what is outside is cut off."""
    mask = np.zeros((size[1], size[0]), np.bool_)
    for shape in shapes:
        if isinstance(shape, Polygon):
            _fill(mask, np.asarray(shape.points, np.float64))
        else:
            _paste(mask, shape)
    return mask


def _fill(mask: Mask, points: F64) -> None:
    """Even-odd filling, row by row: between the first and second edge crossed, the third and fourth, and so on."""
    x0, y0 = points.T
    x1, y1 = np.roll(points, -1, axis=0).T
    first = max(0, int(np.floor(y0.min())))
    last = min(mask.shape[0], int(np.ceil(y0.max())))
    inside = np.zeros(mask.shape[1], np.bool_)
    for row in range(first, last):
        centre = row + 0.5
        crosses = (y0 <= centre) != (y1 <= centre)
        along = (centre - y0[crosses]) / (y1[crosses] - y0[crosses])
        at = np.sort(x0[crosses] + along * (x1[crosses] - x0[crosses]))
        columns = np.clip(np.ceil(at - 0.5), 0, mask.shape[1]).astype(np.intp)
        inside[:] = False
        for start, stop in zip(columns[::2], columns[1::2], strict=True):
            inside[start:stop] = True
        mask[row] |= inside


def _paste(mask: Mask, runs: Runs) -> None:
    is_defect = np.arange(len(runs.counts)) % 2 == 1
    patch = np.repeat(is_defect, runs.counts).reshape(runs.height, runs.width)
    top, left = max(runs.top, 0), max(runs.left, 0)
    patch = patch[top - runs.top : mask.shape[0] - runs.top, left - runs.left : mask.shape[1] - runs.left]
    mask[top : top + patch.shape[0], left : left + patch.shape[1]] |= patch


# <part>_<position>_s<specimen>_p<press>, as `gelgate lab simulate` writes it: at least three digits and two.
_NAME = re.compile(r"(?P<where>.+)_s(?P<specimen>\d{3,})_p(?P<press>\d{2,})")


@dataclass(frozen=True)
class LabelledPress:
    """One frame of a part, with its mask if the part is defective."""

    path: Path
    part: str
    position: str
    size: tuple[int, int]
    """(width, height). The mask comes from `mask_file` or from annotated `shapes`; a good part has an empty one."""
    specimen: str | None = None
    """Id of the physical part, None when unknown."""
    press: int | None = None
    defect: str | None = None
    """Its kind, None for a good part."""
    mask_file: Path | None = None
    shapes: tuple[Shape, ...] = field(default=(), repr=False)

    @property
    def is_defective(self) -> bool:
        return self.defect is not None

    def rgb(self) -> U8:
        """The frame, uint8 (h, w, 3). Errors: DatasetError when the file is broken."""
        return read_rgb(self.path)

    def mask(self) -> Mask:
        """Give the pixels of the defect, bool (h, w) of the frame. Errors: DatasetError when the file is broken."""
        if self.mask_file is not None:
            return read_mask(self.mask_file, self.size)
        return rasterise(self.shapes, self.size)


class Split(NamedTuple):
    """Two sets of presses without a common specimen."""

    kept: tuple[LabelledPress, ...]
    held_out: tuple[LabelledPress, ...]


class Numbered(NamedTuple):
    """The fields of a name such as `PZ3_pos1_s004_p02`; specimen holds the digits."""

    where: str
    specimen: str
    press: int


def numbered(stem: str) -> Numbered | None:
    """The parts of a file's stem as `gelgate lab simulate` writes it, None for any other name."""
    match = _NAME.fullmatch(stem)
    return Numbered(match["where"], match["specimen"], int(match["press"])) if match else None


def parse_name(stem: str, part: str, position: str) -> tuple[str | None, int | None, bool]:
    """(specimen, press, is_misnamed) of a file's stem; a name without a known pattern is not misnamed, only unknown.

    A specimen's id contains its part, so that it is the same at every position.
    """
    name = numbered(stem)
    if name is None:
        return None, None, False
    if name.where != f"{part}_{position}":
        return None, None, True
    return f"{part}_s{name.specimen}", name.press, False


def split_by_specimen(presses: Sequence[LabelledPress], held_out: float, seed: int = 0) -> Split:
    """Hold out about the share `held_out` of the presses, with all presses of a specimen on one side.

    Specimens are drawn in an order fixed by the seed, until the share is reached; each side keeps at least one.
    Errors: DatasetError when specimens are unknown or fewer than two; ValueError for a share outside (0, 1).
    """
    if not 0 < held_out < 1:
        raise ValueError(f"the share held out is in (0, 1), found {held_out}")
    unknown = [p.path.name for p in presses if p.specimen is None]
    if unknown:
        raise DatasetError(
            f"{len(unknown)} presses have no specimen id, such as '{unknown[0]}'; name them "
            "<part>_<position>_s<3 digits>_p<2 digits> or list them in specimens.csv (file,specimen)"
        )
    names = sorted({str(p.specimen) for p in presses})
    if len(names) < 2:
        where = f"{presses[0].part}/{presses[0].position}: " if presses else ""
        raise DatasetError(
            f"{where}a split by specimen needs two specimens, found {len(names)}; add presses of another piece"
        )
    order = np.random.default_rng(seed).permutation(len(names))
    apart: set[str] = set()
    for k in order[:-1]:
        if apart and sum(p.specimen in apart for p in presses) >= held_out * len(presses):
            break
        apart.add(names[k])
    return Split(
        kept=tuple(p for p in presses if p.specimen not in apart),
        held_out=tuple(p for p in presses if p.specimen in apart),
    )


def empty_masks(where: str, defective: Sequence[LabelledPress], masks: Iterable[Mask]) -> list[str]:
    """A sentence if some defective presses show no damage. masks: of the inspected region, bool (h, w) each."""
    empty = [press.path.name for press, mask in zip(defective, masks, strict=True) if not mask.any()]
    if not empty:
        return []
    return [
        f"{len(empty)} of the {len(defective)} defective presses of {where} "
        f"{'has an empty mask' if len(empty) == 1 else 'have empty masks'} in the inspected region, such as "
        f"'{empty[0]}': as presses they count as damaged, all their pixels as sound; check their masks"
    ]


def repeated_pictures(where: str, presses: Sequence[LabelledPress], digests: Sequence[bytes]) -> list[str]:
    """A sentence if some pictures are the same. digests: of the bytes of each press's picture."""
    first: dict[bytes, LabelledPress] = {}
    copies = [
        (first[digest], press)
        for press, digest in zip(presses, digests, strict=True)
        if first.setdefault(digest, press) is not press
    ]
    if not copies:
        return []
    original, copy = copies[0]
    return [
        f"{where} has {len(copies)} {'copy' if len(copies) == 1 else 'copies'} of other pictures, such as "
        f"'{copy.path.name}' of '{original.path.name}': what is learnt and tested too is found too easily; remove "
        "the copies"
    ]
