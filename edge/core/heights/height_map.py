"""The height map of a press: how far each place of the gel is raised above the free gel."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import F32, F64, U8, Mask
from edge.core.contact.reference import fit_levels
from edge.core.errors import HeightError
from edge.core.heights.calibration import SIZE, HeightCalibration, place_powers
from edge.core.printable import score_texts

__all__ = [
    "HeightMap",
    "SlopeFinder",
    "find_touched",
    "free_picture",
    "integrate",
    "measure_heights",
    "part_heights",
]

# Heights brighten the gel a little, so slopes and heights are found in turns; the third moves none by 2 micrometres.
_TURNS: Final = 3
# A touch changes the colours, smoothed over 2 pixels, by more than this many levels; noise and drift reach 6. The least
# is a third of a square millimetre.
_TOUCHED_LEVELS, _SMOOTH_PX, _LEAST_TOUCHED_PX = 10.0, 2.0, 75
_SATURATED_LEVEL, _MOST_SATURATED = 254, 0.1
# The gel is lifted around a touch; what is free lies beyond.
_LIFTED_MM, _LEAST_FREE = 1.5, 0.05


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights of one press."""

    heights_mm: F32
    """float32 (240, 320), towards the camera, 0 on the free gel."""
    u95_mm: F32
    """float32 (240, 320): by how much each may be wrong, 95 %."""
    touched: Mask
    """bool (240, 320), where the colours changed."""
    free: Mask
    """bool (240, 320), the free gel, by which the heights are levelled."""
    mm_per_px: float
    calibration: HeightCalibration


def free_picture(view: F32) -> U8:
    """Return the free gel as contact detection sees it, (120, 160, 3), in the size that heights are measured in."""
    return np.clip(np.rint(cv2.resize(view, SIZE, interpolation=cv2.INTER_CUBIC)), 0, 255).astype(np.uint8)


def measure_heights(
    rgb: U8, free_rgb: U8, calibration: HeightCalibration, serial: str | None = None
) -> HeightMap:
    """Measure a press against its free gel, uint8 (240, 320, 3) each.

    Errors: HeightError for another size or gel, a picture without contact, one that is saturated, and a part that
    covers the view.
    """
    if reason := calibration.why_not(free_rgb, serial):
        raise HeightError(reason)
    change, touched = find_touched(rgb, free_rgb)
    reach = round(_LIFTED_MM / calibration.mm_per_px)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    free = cv2.dilate(touched.astype(np.uint8), kernel) == 0
    if free.mean() < _LEAST_FREE:
        share, least = score_texts(float(free.mean()), _LEAST_FREE, 0, "%")
        raise HeightError(
            f"{share} of the view show free gel, at least {least} are expected, for light and "
            "height are compared there; press so that the part covers less of the view"
        )
    heights = part_heights(change, calibration, calibration.light(free_rgb), free=free)
    return HeightMap(
        heights.astype(np.float32),
        calibration.u95_mm(heights).astype(np.float32),
        touched,
        free,
        calibration.mm_per_px,
        calibration,
    )


def find_touched(rgb: U8, free_rgb: U8) -> tuple[F32, Mask]:
    """Find where a part touches, bool (240, 320), by the change of the colours, float32 (240, 320, 3).

    Errors: HeightError for another size, a picture without contact, and one that is saturated.
    """
    for name, picture in (("press", rgb), ("free gel", free_rgb)):
        if picture.shape != (SIZE[1], SIZE[0], 3):
            raise HeightError(
                f"the picture of the {name} is {picture.shape[1]}x{picture.shape[0]}, heights are calibrated at "
                f"{SIZE[0]}x{SIZE[1]}; give the maker's crop"
            )
    press, ground = rgb.astype(np.float32), free_rgb.astype(np.float32)
    # Noise makes a fitted gain too small, and a hundredth of the light tilts the heights by a tenth of a millimetre.
    change = fit_levels(_smooth(press), _smooth(ground)).applied(press) - ground
    smooth = _smooth(np.linalg.norm(change, axis=2).astype(np.float32))
    # A flat top has the colours of the free gel: what an outline encloses is touched.
    outlines, _ = cv2.findContours(
        np.asarray(smooth > _TOUCHED_LEVELS, np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    touched = cv2.drawContours(np.zeros(smooth.shape, np.uint8), outlines, -1, 1, cv2.FILLED) > 0
    if touched.sum() < _LEAST_TOUCHED_PX:
        raise HeightError(
            f"nothing presses the gel: colours change by {smooth.max():.0f} levels at most, {_TOUCHED_LEVELS:.0f} over "
            f"{_LEAST_TOUCHED_PX} pixels are expected; give a picture of a press and one of the free gel"
        )
    saturated = float((rgb[touched] >= _SATURATED_LEVEL).any(axis=1).mean())
    if saturated > _MOST_SATURATED:
        share, most = score_texts(saturated, _MOST_SATURATED, 0, "%")
        raise HeightError(
            f"{share} of the contact is saturated, at most {most} are accepted, for a colour at "
            "its end tells no slope; lower the exposure"
        )
    return change, touched


def part_heights(
    change: F32,
    calibration: HeightCalibration,
    light: F64,
    box: tuple[float, float, float, float] = (0, 0, 1, 1),
    free: Mask | None = None,
) -> F64:
    """Return the heights of a part of the picture, mm, float64 (h, w).

    change: the press without the free gel, (h, w, 3). box: where the part lies, as shares of the picture. free: places
    whose plane is 0; without any it is the rim.
    """
    h, w = change.shape[:2]
    planes = np.ascontiguousarray(change.transpose(2, 0, 1))
    finder = SlopeFinder(calibration, place_powers((w, h), box), light)
    mm = tuple(
        calibration.mm_per_px * n * (b - a) / m
        for n, m, a, b in zip(SIZE, (w, h), box[:2], box[2:], strict=True)
    )
    heights = np.zeros((h, w))
    for _ in range(_TURNS):
        raw = integrate(*finder.find(planes, np.maximum(heights, 0)), (mm[0], mm[1]))
        heights = _level(raw, free)
    return heights


_STEPS = 3
# A step of a normal's part, and the steepest normal: 67 degrees, beyond any ball that was pressed.
_MOST_STEP, _STEEPEST = np.float32(0.3), np.float32(0.92)


class SlopeFinder:
    """Finds the slopes of one part of the picture whose colours fit best, by Gauss-Newton steps.

    powers: `place_powers` of it. light: the free gel's brightness.
    """

    def __init__(self, calibration: HeightCalibration, powers: F64, light: F64) -> None:
        # Colours are weighed by what the fit left of them; whitened, least squares needs no weights.
        white = np.linalg.cholesky(np.linalg.inv(calibration.rest)).T
        response = calibration.response * light[:, None, None]
        self._per_term = np.tensordot(np.tensordot(white, response, 1), powers, 1).astype(np.float32)
        self._white = white.astype(np.float32)
        self._nx = self._ny = np.zeros(powers.shape[1:], np.float32)

    def find(self, change: F32, raised_mm: F64) -> tuple[F64, F64]:
        """Return the slopes to the right and down, float64 (h, w) each; each call goes on from the last one.

        change: the press without the free gel, float32 (3, h, w). raised_mm: where the gel is by now thought to be.
        """
        term = self._per_term
        target = np.tensordot(self._white, change, 1) - term[:, 5] * raised_mm.astype(np.float32)
        nx, ny = self._nx, self._ny
        for _ in range(_STEPS):
            by_x = term[:, 0] + 2 * term[:, 2] * nx + term[:, 4] * ny
            by_y = term[:, 1] + 2 * term[:, 3] * ny + term[:, 4] * nx
            seen = (term[:, 0] + term[:, 2] * nx + term[:, 4] * ny) * nx + (term[:, 1] + term[:, 3] * ny) * ny
            rest = target - seen
            xx, xy, yy = (by_x * by_x).sum(0), (by_x * by_y).sum(0), (by_y * by_y).sum(0)
            x, y = (by_x * rest).sum(0), (by_y * rest).sum(0)
            # A determinant near 0 has no answer; the step is then held.
            inverse = 1 / np.maximum(xx * yy - xy * xy, np.float32(1e-6) * xx * yy + np.float32(1e-12))
            nx = nx + np.clip((yy * x - xy * y) * inverse, -_MOST_STEP, _MOST_STEP)
            ny = ny + np.clip((xx * y - xy * x) * inverse, -_MOST_STEP, _MOST_STEP)
            length = np.sqrt(nx * nx + ny * ny)
            held = _STEEPEST / np.maximum(length, _STEEPEST)
            nx, ny = nx * held, ny * held
        self._nx, self._ny = nx, ny
        flat = -1 / np.sqrt(1 - nx * nx - ny * ny).astype(np.float64)
        return nx * flat, ny * flat


def integrate(slope_x: F64, slope_y: F64, mm_per_px: tuple[float, float]) -> F64:
    """Return the surface whose steps between neighbours fit best, by least squares: mm, mean 0, float64 (h, w).

    slope_x, slope_y: mm per mm to the right and down, (h, w) with even sides, which OpenCV's transform takes.
    A step between two pixels is the mean of their slopes, and nothing is asked beyond the border (Neumann). The cosine
    transform solves it exactly, with the eigenvalues of this very step: solvers that mix another derivative with them
    are wrong in scale by the size of the feature.
    """
    height, width = slope_x.shape
    across, down = np.zeros((2, height, width))
    across[:, :-1] = (slope_x[:, 1:] + slope_x[:, :-1]) * (mm_per_px[0] / 2)
    down[:-1] = (slope_y[1:] + slope_y[:-1]) * (mm_per_px[1] / 2)
    bend = across + down
    bend[:, 1:] -= across[:, :-1]
    bend[1:] -= down[:-1]
    rows, columns = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (height, width))
    eigenvalues = rows[:, None] + columns
    waves = np.divide(cv2.dct(bend), -eigenvalues, out=np.zeros_like(bend), where=eigenvalues > 0)
    return np.asarray(cv2.dct(waves, flags=cv2.DCT_INVERSE))


def _smooth(picture: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), _SMOOTH_PX), np.float32)


def _level(heights: F64, free: Mask | None) -> F64:
    """Return the heights with the plane through the free places at 0; without any, the median of the rim at 0."""
    if free is None or not free.any():
        rim = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
        return np.asarray(heights - np.median(rim))
    rows, columns = np.nonzero(free)
    sparse = slice(None, None, max(1, len(rows) // 4000))
    at = np.column_stack([columns[sparse], rows[sparse], np.ones(len(rows[sparse]))])
    x, y, level = np.linalg.lstsq(at, heights[free][sparse], rcond=None)[0]
    down, across = np.mgrid[0 : heights.shape[0], 0 : heights.shape[1]]
    return np.asarray(heights - (x * across + y * down + level))
