"""Marks on the gel: dust, wear, the grain of the paint, and the dots of a marker gel.

All of them stay in place from press to press, as on a real cartridge; dust and wear only increase.
"""

import math

import cv2
import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.field_of_view import CROP_MM, LR, Field, grids
from edge.core.arrays import F32, F64

__all__ = [
    "dust",
    "dust_relief",
    "grain",
    "grain_texture",
    "markers",
    "marks_at",
    "new_dust",
    "new_wear",
    "wear",
    "wear_relief",
    "wear_stains",
]

# Specks settle anywhere on the pad, inside the crop and a little beyond.
_SPREAD_MM = (1.25 * CROP_MM[0] / 2, 1.25 * CROP_MM[1] / 2)

# A new gel already carries 1 to 10 specks (counted on four units); about every 60 presses one grain is added (assumed).
_FIRST_SPECKS = 5.0
_PRESSES_PER_SPECK = 60.0
_MOST_SPECKS = 80


def new_dust(rng: np.random.Generator) -> F64:
    """All grains that one gel collects in its life: 0.03 to 0.1 mm across the radius, 0.01 to 0.05 mm high.

    float64 (n, 5), oldest first: x, y, radius, height in mm, and the press at which each appeared.
    """
    n = _MOST_SPECKS
    first = int(np.clip(rng.poisson(_FIRST_SPECKS), 1, 10))
    came = np.concatenate([np.zeros(first), np.cumsum(rng.exponential(_PRESSES_PER_SPECK, n - first))])
    x, y = (rng.uniform(-spread, spread, n) for spread in _SPREAD_MM)
    return np.column_stack([x, y, rng.uniform(0.03, 0.1, n), rng.uniform(0.01, 0.05, n), came])


def marks_at(marks: F64, presses: int) -> int:
    """Count the marks that exist after this many presses; the last column says when each appeared."""
    return int(np.searchsorted(marks[:, -1], presses, side="right"))


def dust_relief(grains: F64, presses: int, field: Field) -> F32:
    """The grains after this many presses, as bumps in mm, float32 (h, w)."""
    relief = np.zeros(field.shape, dtype=np.float32)
    x, y = grids(field)
    for gx, gy, radius, height, came in grains.tolist():
        if came > presses:
            break
        window = _window(field, gx, gy, 3 * radius)
        r2 = (x[window] - gx) ** 2 + (y[window] - gy) ** 2
        relief[window] += height * reproducible_math.exp(-r2 / (2 * radius * radius))
    return relief


def dust(surface_mm: F32, relief_mm: F32) -> F32:
    """The surface with grains between coat and part: small bumps, clearest on the free gel."""
    return np.asarray(surface_mm + relief_mm, dtype=np.float32)


def _window(field: Field, x_mm: float, y_mm: float, reach_mm: float) -> tuple[slice, slice]:
    column = (x_mm - field.centre_mm[0]) / field.mm_per_px[0] + field.size[0] / 2
    row = (y_mm - field.centre_mm[1]) / field.mm_per_px[1] + field.size[1] / 2
    across, down = reach_mm / field.mm_per_px[0] + 1, reach_mm / field.mm_per_px[1] + 1
    return (
        slice(max(0, int(row - down)), max(0, math.ceil(row + down))),
        slice(max(0, int(column - across)), max(0, math.ceil(column + across))),
    )


# A gel is rated for 1000 presses and two gels lasted 2678 images in the published work: by then it is covered.
_PRESSES_PER_SCRATCH = 40.0
_PRESSES_PER_STAIN = 150.0
_MOST_MARKS = 60


def new_wear(rng: np.random.Generator) -> tuple[F64, F64]:
    """All marks that one gel gets in its life: scratches 1 to 5 mm long, 2 to 9 micrometres deep, and dull stains.

    Scratches, float64 (n, 6), oldest first: x, y mm, direction rad, length mm, depth mm, press. Stains, float64 (n, 5):
    x, y mm, radius mm, share of light lost, press.
    """

    def draw(each: float, *ends: tuple[float, float]) -> F64:
        place = [rng.normal(0, 0.375 * spread, _MOST_MARKS) for spread in _SPREAD_MM]
        form = [rng.uniform(*between, _MOST_MARKS) for between in ends]
        return np.column_stack([*place, *form, np.cumsum(rng.exponential(each, _MOST_MARKS))])

    scratches = draw(_PRESSES_PER_SCRATCH, (0, math.pi), (1.0, 5.0), (0.002, 0.009))
    return scratches, draw(_PRESSES_PER_STAIN, (0.4, 1.8), (0.02, 0.09))


_SCRATCH_HALF_WIDTH_MM = 0.05


def wear_relief(scratches: F64, presses: int, field: Field) -> F32:
    """The scratches after this many presses, as shallow furrows in mm (negative), float32 (h, w)."""
    relief = np.zeros(field.shape, dtype=np.float32)
    x, y = grids(field)
    for sx, sy, turn, length, depth, came in scratches.tolist():
        if came > presses:
            break
        window = _window(field, sx, sy, length / 2 + 0.2)
        dx, dy = x[window] - sx, y[window] - sy
        along = math.cos(turn) * dx + math.sin(turn) * dy
        across = math.cos(turn) * dy - math.sin(turn) * dx + 0.03 * along * along
        line = reproducible_math.exp(-((across / _SCRATCH_HALF_WIDTH_MM) ** 2))
        ends = np.clip((length / 2 - np.abs(along)) / 0.3, 0, 1)
        relief[window] -= depth * line * ends
    return relief


def wear_stains(stains: F64, presses: int, field: Field) -> F32:
    """The share of light that the coat still returns after this many presses, float32 (h, w), 1 where it is new."""
    keeps = np.ones(field.shape, dtype=np.float32)
    x, y = grids(field)
    for sx, sy, radius, lost, came in stains.tolist():
        if came > presses:
            break
        # A stain that appeared at press n is fully dark at press 2n.
        share = min(1.0, (presses - came) / max(came, 1.0))
        r2 = (x - sx) ** 2 + (y - sy) ** 2
        keeps *= 1 - lost * share * reproducible_math.exp(-r2 / (2 * radius * radius))
    return keeps


def wear(surface_mm: F32, relief_mm: F32) -> F32:
    """The surface with the furrows that presses have cut into the coat; stains come with the light."""
    return np.asarray(surface_mm + relief_mm, dtype=np.float32)


# A flake's size, and the share of the paint's grain that the free gel shows.
GRAIN_SIGMA_MM = 0.035
GRAIN_FREE = 0.35
# Paint grain: high-pass sd outside and inside contact is B 2.7 to 3.2, G 1.5 to 2.3, R 2.1 to 2.8 grey levels.
# Its part beyond the camera's own noise is about 1.8 levels in contact and a third of that on the free gel.
_GRAIN_LEVELS = 1.8


def grain_texture(rng: np.random.Generator, field: Field) -> F32:
    """The speckle of one coat, float32 (h, w), mean 0, sd 1, correlated over the size of a flake."""
    texture = rng.standard_normal(field.shape, dtype=np.float32)
    sx, sy = (GRAIN_SIGMA_MM / m for m in field.mm_per_px)
    texture = np.asarray(cv2.GaussianBlur(texture, (0, 0), sx, sigmaY=sy), dtype=np.float32)
    return texture / np.float32(texture.std(dtype=np.float64))


def grain(planes: F32, surface_mm: F32, texture: F32) -> F32:
    """The planes with the coat's speckle, which a stretched coat shows about three times as strongly."""
    stretched = np.clip(surface_mm / 0.1, 0, 1)
    speckle = texture * (_GRAIN_LEVELS * GRAIN_FREE + _GRAIN_LEVELS * (1 - GRAIN_FREE) * stretched)
    for plane in planes:
        plane += speckle
    return planes


# A tracking gel carries 7 x 9 dots in the crop: margin 24 px and radius about 6 px at 320x240.
DOT_PITCH_MM = ((320 - 48) / 8 * LR.mm_per_px[0], (240 - 48) / 6 * LR.mm_per_px[0])
DOT_RADIUS_MM = 6 * LR.mm_per_px[0]
DOT_KEEPS = 0.22
# Dots move away from a bulge by about this share of its depth (estimated from the maker's marker video).
DOT_SPREAD_MM = 0.5


def markers(planes: F32, surface_mm: F32, field: Field) -> F32:
    """The planes under a grid of dark dots that spread away from where the gel bulges.

    Source: dot sizes as the maker's tracking gel shows them; the spread follows the slope of the smoothed bulge.
    """
    x, y = grids(field)
    sx, sy = (0.6 / m for m in field.mm_per_px)
    shrunk = cv2.resize(surface_mm, (field.size[0] // 4, field.size[1] // 4), interpolation=cv2.INTER_AREA)
    smooth = cv2.resize(cv2.GaussianBlur(shrunk, (0, 0), sx / 4, sigmaY=sy / 4), field.size)
    push_x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=DOT_SPREAD_MM / (8 * field.mm_per_px[0]))
    push_y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=DOT_SPREAD_MM / (8 * field.mm_per_px[1]))
    u, v = x + push_x, y + push_y
    u -= DOT_PITCH_MM[0] * np.round(u / DOT_PITCH_MM[0])
    v -= DOT_PITCH_MM[1] * np.round(v / DOT_PITCH_MM[1])
    edge = max(field.mm_per_px)
    covered = np.clip((DOT_RADIUS_MM - cv2.sqrt(u * u + v * v)) / edge + 0.5, 0, 1)
    planes *= 1 - (1 - DOT_KEEPS) * covered
    return planes
