"""Pictures of known surfaces by a gel whose colours answer exactly as its calibration says."""

from dataclasses import replace

import numpy as np

from edge.core.arrays import F64, U8
from edge.core.heights.calibration import CELLS, SIZE, HeightCalibration, place_powers, surface_terms
from edge.core.imaging.sensor_check import colour_cells

MM_PER_PX = 0.0634


def free_gel() -> U8:
    """Teal above, pink below, darker to the sides."""
    power = place_powers(SIZE)
    planes = [130 - 20 * power[2] - 20 * power[3], 120 - 15 * power[3], 115 + 20 * power[2] - 15 * power[3]]
    return np.rint(np.stack(planes, axis=2)).astype(np.uint8)


def calibration(height_response: float = 12.0) -> HeightCalibration:
    """The response of a real unit: red to the vertical slope, green to the horizontal one, all to the height."""
    response = np.zeros((3, 6, 6))
    response[:, 0, 0] = (-20, 105, 8)
    response[:, 1, 0] = (-120, 10, 90)
    response[1, 0, 3] = -20
    response[0, 3, 0] = 30
    response[:, 5, 0] = height_response
    return HeightCalibration(
        name="lit",
        response=response,
        rest=np.diag([9.0, 4.0, 9.0]),
        free_levels=colour_cells(free_gel(), CELLS),
        mm_per_px=MM_PER_PX,
        scale_u95=0.01,
        floor_u95_mm=0.02,
        height_u95=0.1,
        noise_mm=0.0005,
    )


def grid() -> tuple[F64, F64]:
    """x and y in mm from the middle of the picture."""
    across, down = ((np.arange(n) + 0.5 - n / 2) * MM_PER_PX for n in SIZE)
    x, y = np.meshgrid(across, down)
    return x, y


def light(surface_mm: F64, by: HeightCalibration, noise: float = 0.0) -> U8:
    """The picture of a surface, uint8 (240, 320, 3); its slopes are central differences."""
    down, across = np.gradient(surface_mm, MM_PER_PX)
    normal = np.stack([-across, -down]) / np.sqrt(across**2 + down**2 + 1)
    terms = surface_terms(normal, surface_mm)
    change = np.einsum("ctp,phw,thw->hwc", by.response, place_powers(SIZE), terms)
    if noise:
        change += np.random.default_rng(5).normal(0, noise, change.shape)
    return np.clip(np.rint(free_gel() + change), 0, 255).astype(np.uint8)


def other_gel() -> HeightCalibration:
    """A calibration whose gel has other colours."""
    levels = calibration().free_levels.copy()
    levels[:, :4, 0] *= 1.3
    return replace(calibration(), free_levels=levels)
