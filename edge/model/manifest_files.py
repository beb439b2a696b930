"""The files and arrays of a manifest, and the largest sizes that any bundle may have.

The limits are the program's: a manifest cannot raise them.
"""

import math
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from edge.core.detector import Packing
from edge.core.imaging.sensor_profile import LONGEST_SIDE
from edge.model.archive import MAX_FILE_BYTES
from edge.pictures.nominal_pictures import MOST_PICTURES

if TYPE_CHECKING:
    from edge.core.imaging.marker_dots import MarkerDots

__all__ = [
    "LONGEST_NAME",
    "MAX_ARRAY_BYTES",
    "MAX_BUNDLE_BYTES",
    "ArrayEntry",
    "Count",
    "DotsEntry",
    "Entry",
    "FileEntry",
    "Name",
    "PicturesEntry",
    "RegistrationEntry",
    "Side",
]

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]

RelativeFile = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)?$")
]
"""A file of the bundle: at most one folder deep, no leading dot, so neither absolute nor `..`."""

LONGEST_NAME: Final = 128

Name = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]

Side = Annotated[int, Field(ge=1, le=LONGEST_SIDE)]

Count = Annotated[int, Field(ge=0, le=2**53)]

Levels = tuple[float, float]

MAX_ARRAY_BYTES: Final = 4 << 30
"""The largest bank array or tap in memory; the largest known bank has 62 MB."""

MAX_BUNDLE_BYTES: Final = 2 << 30
"""All files of a bundle together."""


class Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class FileEntry(Entry):
    """One file: its place in the bundle, and the hash and size of its bytes."""

    file: RelativeFile
    sha256: Sha256
    size_bytes: int = Field(ge=0, le=MAX_FILE_BYTES)


class ArrayEntry(Entry):
    """One bank array. dtype and shape are those of the head's input; `packing` says how `data` stores it.

    `scale` belongs to int8 (float32, one per row of the last axis), `exponent` to float16 (times 2**exponent).
    """

    dtype: Literal["float32", "int64", "bool"]
    shape: tuple[Annotated[int, Field(ge=0, le=2**31 - 1)], ...] = Field(max_length=8)
    packing: Packing = "none"
    data: FileEntry
    scale: FileEntry | None = None
    exponent: int = Field(default=0, ge=-400, le=400)

    @model_validator(mode="after")
    def _fits(self) -> "ArrayEntry":
        if self.bytes_unpacked > MAX_ARRAY_BYTES:
            raise ValueError(f"an array has at most {MAX_ARRAY_BYTES} bytes, found {self.bytes_unpacked}")
        return self

    @property
    def bytes_stored(self) -> int:
        return self.data.size_bytes + (self.scale.size_bytes if self.scale else 0)

    @property
    def bytes_unpacked(self) -> int:
        return math.prod(self.shape) * {"float32": 4, "int64": 8, "bool": 1}[self.dtype]


class RegistrationEntry(Entry):
    """`PartInPose`: free, template and learnt are pictures of the region, learnt white where the bank is learnt.

    colours: for red, green and blue the levels of the two slopes. is_turning: false where the part has no turn, as a
    ball. symmetry, nearly: how often it looks the same in a full turn, and nearly so; 1 in bundles that do not state
    it. least_match, least_seen: a press below either is rejected. is_held: the part lies near the bank's pose; false in
    bundles that do not state it. scores_relief_to_end: false in bundles that do not state it; they were fitted with a
    seam around what a press shows that is not scored. gel_limits: a grey picture of the sixteenths by which the limit
    is higher at a place of the gel; none where it is one limit.
    """

    free: FileEntry
    template: FileEntry
    learnt: FileEntry
    colours: tuple[Levels, Levels, Levels]
    is_turning: bool
    symmetry: int = Field(default=1, ge=1)
    nearly: int = Field(default=1, ge=0, le=12)
    least_match: float = Field(gt=0, lt=1)
    least_seen: float = Field(ge=0, le=1)
    is_held: bool = False
    scores_relief_to_end: bool = False
    gel_limits: FileEntry | None = None

    @property
    def files(self) -> tuple[FileEntry, ...]:
        pictures = self.free, self.template, self.learnt
        return pictures if self.gel_limits is None else (*pictures, self.gel_limits)


class PicturesEntry(Entry):
    """`NominalPictures`: one file with a picture for each name, of this size, one below the other."""

    file: FileEntry
    size: tuple[Annotated[int, Field(ge=1, le=512)], Annotated[int, Field(ge=1, le=512)]]
    names: tuple[Name, ...] = Field(min_length=1, max_length=MOST_PICTURES)


Pixels = Annotated[float, Field(ge=-LONGEST_SIDE, le=2 * LONGEST_SIDE)]


class DotsEntry(Entry):
    """`MarkerDots`, in pixels of the region: the dots of the gel, which are filled in a press before anything else.

    places: x and y on the free gel. darker: the share of the light by which a dot's pixel is darker. largest: area
    of the largest dot in discs of that width, where each learnt press shows every dot; absent in older bundles.
    """

    places: tuple[tuple[Pixels, Pixels], ...] = Field(min_length=1, max_length=4096)
    apart_px: Pixels
    width_px: float = Field(ge=1, le=LONGEST_SIDE)
    darker: float = Field(gt=0, lt=1)
    largest: float | None = Field(None, gt=0)

    @classmethod
    def of(cls, dots: "MarkerDots") -> "DotsEntry":
        places = tuple((float(x), float(y)) for x, y in dots.places)
        return cls(
            places=places,
            apart_px=dots.apart_px,
            width_px=dots.width_px,
            darker=dots.darker,
            largest=dots.largest,
        )

    @cached_property
    def opened(self) -> "MarkerDots":
        """What fills them in presses."""
        from edge.core.imaging.marker_dots import MarkerDots

        return MarkerDots(np.array(self.places), self.apart_px, self.width_px, self.darker, self.largest)

    @model_validator(mode="after")
    def _apart(self) -> "DotsEntry":
        _ = self.opened
        return self
