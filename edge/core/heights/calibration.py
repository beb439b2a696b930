"""What presses of a ball tell of one gel: how its colours answer its surface, and how well heights come back."""

from dataclasses import dataclass
from datetime import date
from typing import Final

import numpy as np

from edge.core.arrays import F64, U8
from edge.core.imaging.sensor_check import colour_cells, colour_distance
from edge.core.printable import score_texts

__all__ = [
    "CELLS",
    "MAKERS_SCALE_U95",
    "MEASURED_SCALE_U95",
    "SIZE",
    "HeightCalibration",
    "place_powers",
    "surface_terms",
]

SIZE: Final = (320, 240)
"""(width, height) of the picture that is calibrated, the maker's crop."""
CELLS: Final = (6, 8)
"""(rows, columns) of the coarse colours by which a gel is recognised."""
# Two figures of the maker for one view differ by 8 % (`known_profiles`). A rule over 15 mm is read to a pixel or two.
MAKERS_SCALE_U95: Final = 0.08
MEASURED_SCALE_U95: Final = 0.01
# Two public pictures of one gel from two sessions differ by 0.020 (colours without their common gain, as a share of the
# light), those of four units by 0.031 to 0.14.
_OTHER_GEL: Final = 0.03


def place_powers(size: tuple[int, int], box: tuple[float, float, float, float] = (0, 0, 1, 1)) -> F64:
    """Return (1, u, v, u^2, v^2, uv) at pixel centres, float64 (6, h, w); u and v run from -1 to 1 over the picture.

    size: (width, height) of the part. box: left, top, right, bottom of the part, as shares of the picture.
    """
    across, down = (
        2 * (first + (last - first) * (np.arange(n) + 0.5) / n) - 1
        for n, first, last in zip(size, box[:2], box[2:], strict=True)
    )
    u, v = np.meshgrid(across, down)
    return np.stack([np.ones_like(u), u, v, u * u, v * v, u * v])


def surface_terms(normal: F64, raised_mm: F64) -> F64:
    """Return what colours answer to: nx and ny of the normal, (2, ...), their squares and product, and the height."""
    nx, ny = normal
    return np.stack([nx, ny, nx * nx, ny * ny, nx * ny, raised_mm])


@dataclass(frozen=True, eq=False)
class HeightCalibration:
    """One sensor with one gel."""

    name: str
    response: F64
    """float64 (3, 6, 6): grey levels of red, green and blue, per nx, ny, nx^2, ny^2, nx ny and mm raised, each times
    (1, u, v, u^2, v^2, uv) of the place."""
    rest: F64
    """float64 (3, 3), covariance of what the fit leaves of the colours, levels squared."""
    free_levels: F64
    """float64 (6, 8, 3), coarse colours of the free gel, by which another gel is refused."""
    mm_per_px: float
    """Of a picture of 320x240, both ways."""
    scale_u95: float
    """Share by which the scale may be wrong, 95 %."""
    floor_u95_mm: float
    """Of a height anywhere, 95 %: what is left on the free gel, and of tilt."""
    height_u95: float
    """Share of a height by which it may be wrong besides, 95 %, of balls that were held out."""
    noise_mm: float
    """Standard deviation of heights of the free gel between 0.25 and 0.8 mm."""
    serial: str | None = None
    """The sensor, another one is refused; None where it was not known."""
    made_on: date | None = None
    """Day of the calibration, UTC; None in files that do not say it."""

    def __post_init__(self) -> None:
        shapes = (self.response.shape, self.rest.shape, self.free_levels.shape)
        if shapes != ((3, 6, 6), (3, 3), (*CELLS, 3)):
            raise ValueError(
                f"response, rest and free levels are (3, 6, 6), (3, 3) and (6, 8, 3), found {shapes}"
            )
        if not np.linalg.eigvalsh(self.rest).min() > 0:
            raise ValueError("rest is the covariance of three colours, positive in every direction")

    def why_not(self, free_rgb: U8, serial: str | None = None) -> str:
        """Say why this calibration does not serve a gel, empty where it does. free_rgb: uint8 (h, w, 3)."""
        if serial and self.serial and serial != self.serial:
            return (
                f"calibration '{self.name}' is of sensor {self.serial}, this press is of sensor {serial}; "
                "calibrate that one"
            )
        distance = colour_distance(colour_cells(free_rgb, CELLS), self.free_levels)
        if distance > _OTHER_GEL:
            share, most = score_texts(distance, _OTHER_GEL, 0, "%")
            return (
                f"the free gel differs from that of calibration '{self.name}' by {share} of its light, at most "
                f"{most}: another gel, sensor or crop; calibrate again with this gel"
            )
        return ""

    def light(self, free_rgb: U8) -> F64:
        """Return how much brighter the free gel is than at calibration, float64 (3,) of red, green and blue."""
        return np.asarray(
            colour_cells(free_rgb, CELLS).mean(axis=(0, 1)) / self.free_levels.mean(axis=(0, 1))
        )

    def u95_mm(self, heights_mm: F64) -> F64:
        """Return by how much heights may be wrong, 95 %, mm. A scale that is wrong makes slopes wrong as well."""
        return np.asarray(self.floor_u95_mm + (self.height_u95 + 2 * self.scale_u95) * np.abs(heights_mm))
