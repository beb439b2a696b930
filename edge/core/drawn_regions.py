"""Regions that a person draws on a part: where nothing is judged, where alone something is, and where more strictly.

They lie in the bank's pose, in millimetres from the top left corner of the inspected region, right and down, as the
places of defects do. With registration they follow the part. What they do to a score map is one weight for each place:

    0 where it is ignored, or where other places alone are judged; the factor where it is stricter; else 1

Where regions overlap, `ignore` decides before the highest factor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from edge.core.registration.pose import Pose

__all__ = [
    "LARGEST_FACTOR",
    "LEAST_JUDGED_MM2",
    "DrawnRegion",
    "DrawnRegions",
    "Points",
    "RegionKind",
    "find_blind",
    "region_at",
    "weigh_places",
]

RegionKind = Literal["ignore", "judge", "stricter"]
Points = tuple[tuple[float, float], ...]

LARGEST_FACTOR: Final = 10.0
"""Below a tenth of the limit a map shows noise, which no factor makes a damage."""

LEAST_JUDGED_MM2: Final = 1.0
"""A press that touches less than this where it is judged is not judged: about the place that one defect raises."""

_MOST_POINTS: Final = 256
_LONGEST_NAME: Final = 64
_LEAST_AREA_MM2: Final = 1e-6
# OpenCV draws polygons in this fraction of a pixel.
_SHIFT: Final = 4


@dataclass(frozen=True)
class DrawnRegion:
    """One polygon. Errors: ValueError, one sentence."""

    name: str
    kind: RegionKind
    points_mm: Points
    """x and y of its corners in turn; the last is joined to the first."""
    factor: float = 1.0
    """Of `stricter`: scores count this many times there, so the limit is divided by it."""

    def __post_init__(self) -> None:
        if not (0 < len(self.name) <= _LONGEST_NAME and self.name.isprintable() and self.name.strip()):
            raise ValueError(
                f"a region has a name of 1 to {_LONGEST_NAME} characters, found {self.name!r:.80}"
            )
        where, points = f"region '{self.name}'", self.points_mm
        if self.kind not in get_args(RegionKind):
            raise ValueError(f"{where} is of the kind '{self.kind}', expected ignore, judge or stricter")
        if not 3 <= len(points) <= _MOST_POINTS:
            raise ValueError(f"{where} has {len(points)} points, expected 3 to {_MOST_POINTS}; draw it again")
        if not all(math.isfinite(value) for point in points for value in point):
            raise ValueError(f"{where} has a point that is not two finite numbers of mm; write it as x,y")
        if _crosses_itself(points):
            raise ValueError(f"{where} crosses itself or has no area; draw its corners in turn")
        if self.kind == "stricter" and not 1 < self.factor <= LARGEST_FACTOR:
            raise ValueError(
                f"{where} has the factor {self.factor:g}, expected more than 1 and at most {LARGEST_FACTOR:g}: scores "
                "count that many times there"
            )
        if self.kind != "stricter" and self.factor != 1:
            raise ValueError(
                f"{where} has the factor {self.factor:g}, and {self.kind} has none; leave it out"
            )

    def mask(self, frame: tuple[int, int], mm_per_pixel: tuple[float, float]) -> Mask:
        """Return its places, bool (h, w). frame: (h, w) of the inspected region."""
        pixels = self.pixels(mm_per_pixel) - 0.5  # OpenCV's pixel centres are integers
        filled = np.zeros(frame, np.uint8)
        corners = np.rint(pixels * 2**_SHIFT).astype(np.int32)
        return np.asarray(cv2.fillPoly(filled, [corners], 1, shift=_SHIFT) > 0)

    def pixels(self, mm_per_pixel: tuple[float, float]) -> F64:
        """Return its corners in pixels from the corner of the picture, float64 (n, 2)."""
        return np.asarray(np.array(self.points_mm, np.float64) / np.array(mm_per_pixel), np.float64)

    def corners_in_press(
        self, mm_per_pixel: tuple[float, float], frame: tuple[int, int], pose: Pose | None
    ) -> F64:
        """Return its corners where the part lies in a press, as `pixels`. frame: (h, w) of the inspected region."""
        corners = self.pixels(mm_per_pixel)
        if pose is None:
            return corners
        matrix = pose.matrix((frame[1], frame[0]))
        return np.asarray((corners - 0.5) @ matrix[:, :2].T + matrix[:, 2] + 0.5, np.float64)

    def check_inside(self, frame: tuple[int, int], mm_per_pixel: tuple[float, float]) -> None:
        """Errors: ValueError for a region that reaches out of the inspected region, (h, w)."""
        wide, high = frame[1] * mm_per_pixel[0], frame[0] * mm_per_pixel[1]
        slack = max(mm_per_pixel)
        for x, y in self.points_mm:
            if not (-slack <= x <= wide + slack and -slack <= y <= high + slack):
                raise ValueError(
                    f"region '{self.name}' has a point at ({x:g}, {y:g}) mm, outside the field of {wide:.1f} x "
                    f"{high:.1f} mm; places are counted from its top left corner"
                )


@dataclass(frozen=True)
class DrawnRegions:
    """The regions of a bundle, and what of the nominal contact they leave out. Errors: ValueError."""

    regions: tuple[DrawnRegion, ...]
    ignored_mm2: float = 0.0
    """Of the contact of nominal presses what is not judged."""
    contact_mm2: float = 0.0
    """The contact of nominal presses; 0 where nothing is ignored."""

    def __post_init__(self) -> None:
        names = [region.name for region in self.regions]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(
                f"two regions have the name '{twice}'; remove the first one, or name the other otherwise"
            )

    def describe(self) -> str:
        """Say what is ignored, how many regions there are, and how much stricter, in a few words."""
        kinds = [region.kind for region in self.regions]
        counts = [f"{kinds.count(kind)} {kind}" for kind in get_args(RegionKind) if kind in kinds]
        factors = [f"{region.factor:g}" for region in self.regions if region.kind == "stricter"]
        if factors:  # the last kind
            counts[-1] += f" (limit / {', '.join(factors)})"
        ignored = f"ignored: {self.ignored_mm2:.1f} mm2 of {self.contact_mm2:.0f} mm2 contact; "
        return (ignored if self.contact_mm2 else "") + ", ".join(counts)


def weigh_places(
    regions: Sequence[DrawnRegion], frame: tuple[int, int], mm_per_pixel: tuple[float, float]
) -> F32:
    """Return the weight of each place of a score map, float32 (h, w)."""
    weights = np.full(frame, 0 if any(drawn.kind == "judge" for drawn in regions) else 1, np.float32)
    for kind in ("judge", "stricter", "ignore"):
        for region in regions:
            if region.kind == kind:
                mask = region.mask(frame, mm_per_pixel)
                weights[mask] = (
                    0 if kind == "ignore" else np.maximum(weights[mask], np.float32(region.factor))
                )
    return weights


def find_blind(weights: NDArray[np.floating]) -> Mask | None:
    """Find the places that are not judged, bool (h, w); None for none."""
    blind = weights == 0
    return np.asarray(blind) if blind.any() else None


def region_at(
    regions: Sequence[DrawnRegion],
    place_px: tuple[float, float],
    mm_per_pixel: tuple[float, float],
    frame: tuple[int, int],
    pose: Pose | None,
) -> DrawnRegion | None:
    """Find the smallest region around a place (x, y) of a press in this pose; None where there is none."""
    around = []
    for region in regions:
        corners = region.corners_in_press(mm_per_pixel, frame, pose).astype(np.float32)
        if cv2.pointPolygonTest(corners, place_px, False) >= 0:
            around.append((cv2.contourArea(corners), region.name, region))
    return min(around)[-1] if around else None


def _crosses_itself(points: Points) -> bool:
    """Tell whether two sides have a point in common that is no corner of both, or there is no area."""
    corners = np.array(points, np.float64)
    (x, y), (to_x, to_y) = corners.T, np.roll(corners, -1, axis=0).T
    if len(set(points)) != len(points) or abs((x * to_y - to_x * y).sum()) / 2 < _LEAST_AREA_MM2:
        return True
    # [j, k]: on which side of side j corner k lies, and whether it lies on it; its own two ends do, and are left out.
    side = np.sign((to_x - x)[:, None] * (y - y[:, None]) - (to_y - y)[:, None] * (x - x[:, None]))
    on = side == 0
    for start, end in ((x, to_x), (y, to_y)):
        low, high = np.minimum(start, end)[:, None], np.maximum(start, end)[:, None]
        on &= (low <= start) & (start <= high)
    own = np.eye(len(points), dtype=bool)
    parted = side * np.roll(side, -1, axis=1) < 0  # side j parts the ends of side k
    return bool((on & ~own & ~np.roll(own, 1, axis=1)).any() or (parted & parted.T).any())
