"""One press of a dataset, and how presses are divided so that no specimen is on both sides."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.files import read_mask, read_rgb
from calibration.dataset.shapes import Shape, rasterise
from edge.core.errors import DatasetError

__all__ = ["LabelledPress", "Split", "numbered", "parse_name", "split_by_specimen"]

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

    def rgb(self) -> NDArray[np.uint8]:
        """The frame, uint8 (h, w, 3). Errors: DatasetError when the file is broken."""
        return read_rgb(self.path)

    def mask(self) -> NDArray[np.bool_]:
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
