"""Roughness of a region of a height map: Ra and Rz of its lines, Sa and Sz of its area, with what a gel can show.

Profiles as in ISO 21920-2 (Ra, and Rz over five sections) and areas as in ISO 25178-2, after the Gaussian filters of
ISO 16610-21 and -61. Half a cut-off at each end, where a filter knows no neighbours, is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import F64
from edge.core.errors import HeightError
from edge.core.heights.height_map import HeightMap
from edge.core.imaging.region import Region

__all__ = ["CUT_OFFS_MM", "SHORTEST_MM", "Roughness", "band", "measure_roughness"]

SHORTEST_MM: Final = 0.25
"""Of a wave that a gel shows: four pixels, of which its coat and the lens leave 0.4; of 0.5 mm they leave 0.8."""
CUT_OFFS_MM: Final = (0.8, 2.5)
"""Of ISO 21920-3, those that fit between what a gel shows and its size."""
_SECTIONS: Final = 5
# Standard deviation of the Gaussian filter over its cut-off: 0.4697 / sqrt(2 pi).
_SIGMA: Final = 0.18738
# Of noise with this standard deviation: Ra and Sa are 0.8 of it, heights over five sections 4, over an area 8.
_OF_NOISE: Final = {"Ra": 0.8, "Rz": 4.0, "Sa": 0.8, "Sz": 8.0}
# A value that is not this many times its noise is not told from it.
_TOLD: Final = 3.0


@dataclass(frozen=True)
class Roughness:
    """One parameter of one region."""

    parameter: str
    """Ra, Rz, Sa or Sz."""
    along: str
    """x or y, the direction of the lines; empty for an area."""
    value_um: float | None
    """None where it is below `limit_um`."""
    u95_um: float
    """By how much it may be wrong, 95 %."""
    limit_um: float
    """What is below this the sensor does not show."""

    def __str__(self) -> str:
        name = f"{self.parameter} along {self.along}" if self.along else self.parameter
        if self.value_um is None:
            return f"{name} is below {self.limit_um:.1f} um"
        return f"{name} {self.value_um:.1f} um, +- {self.u95_um:.1f} um (95 %)"


def band(heights: F64, mm_per_px: float, cut_off_mm: float) -> F64:
    """Return the roughness of a surface, float64 (h, w): waves between `SHORTEST_MM` and the cut-off."""
    return _smooth(heights, SHORTEST_MM / mm_per_px) - _smooth(heights, cut_off_mm / mm_per_px)


def measure_roughness(
    heights: HeightMap, region: Region, cut_off_mm: float = CUT_OFFS_MM[0]
) -> list[Roughness]:
    """Measure a region of the picture; lines in each direction that is long enough.

    Errors: HeightError for a region outside the contact, and one too small for the cut-off.
    """
    width, height = region.width, region.height
    part = region.crop(heights.touched)
    if not part.all():
        raise HeightError(
            f"{1 - part.mean():.0%} of the region {region} is not touched, so it shows the gel; name "
            "a region within the contact"
        )
    mm = heights.mm_per_px
    end = round(cut_off_mm / mm / 2)
    section = round(cut_off_mm / mm)
    needed = 2 * end + _SECTIONS * section
    if max(width, height) < needed:
        raise HeightError(
            f"the region is {width}x{height} pixels ({width * mm:.1f} x {height * mm:.1f} mm), a cut-off of "
            f"{cut_off_mm:g} mm needs {needed} pixels ({needed * mm:.1f} mm) one way; name a larger one"
        )
    rough = band(_without_form(region.crop(heights.heights_mm).astype(np.float64)), mm, cut_off_mm)
    measures: list[tuple[str, str, float]] = []
    for along, lines, across in (("x", rough, height), ("y", rough.T, width)):
        if lines.shape[1] >= needed:
            inner = lines[:, end : end + _SECTIONS * section].reshape(across, _SECTIONS, section)
            measures += [(name, along, 1e3 * measure(inner)) for name, measure in _PROFILE.items()]
    if min(width, height) >= needed:
        area = rough[end:-end, end:-end]
        measures += [
            ("Sa", "", 1e3 * float(np.abs(area - area.mean()).mean())),
            ("Sz", "", 1e3 * float(np.ptp(area))),
        ]
    return [_judge(heights, *measure) for measure in measures]


_PROFILE: Final[dict[str, Callable[[F64], float]]] = {
    "Ra": lambda lines: float(np.abs(lines - lines.mean(axis=(1, 2), keepdims=True)).mean()),
    "Rz": lambda lines: float(np.ptp(lines, axis=2).mean()),
}


def _judge(heights: HeightMap, parameter: str, along: str, value_um: float) -> Roughness:
    calibration = heights.calibration
    noise_um = 1e3 * calibration.noise_mm * _OF_NOISE[parameter]
    limit = _TOLD * noise_um
    u95 = value_um * (calibration.height_u95 + 2 * calibration.scale_u95) + noise_um
    return Roughness(parameter, along, value_um if value_um >= limit else None, u95, limit)


def _smooth(heights: F64, cut_off_px: float) -> F64:
    sigma = _SIGMA * cut_off_px
    side = 2 * int(np.ceil(0.5 * cut_off_px)) + 1
    return np.asarray(
        cv2.GaussianBlur(heights, (side, side), sigma, borderType=cv2.BORDER_REFLECT), np.float64
    )


def _without_form(heights: F64) -> F64:
    """Return the heights without their plane and curvature, by least squares."""
    rows, columns = (np.linspace(-1, 1, n) for n in heights.shape)
    u, v = np.meshgrid(columns, rows)
    terms = np.stack([np.ones_like(u), u, v, u * u, v * v, u * v]).reshape(6, -1)
    form = np.linalg.lstsq(terms.T, heights.ravel(), rcond=None)[0] @ terms
    return np.asarray(heights - form.reshape(heights.shape))
