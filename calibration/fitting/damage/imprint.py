"""The gel's surface under a real press, from the three colours: photometric stereo with the sensor's linear response.

The response is the simulator's (`sensor_appearance`, fitted to presses of a ball), so heights are as good as it is: on
simulated parts the surface is right in shape (correlation 0.95 and more) and up to a quarter too high.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calibration.simulator import camera, optics, sensor_appearance
from calibration.simulator.camera import NOISE_SD
from calibration.simulator.field_of_view import Field
from calibration.simulator.gel import GEL
from edge.core.arrays import F32, U8
from edge.core.heights.height_map import integrate
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["Station"]

# Noise and grain are smoothed over one pixel of 320x240 before slopes are taken.
_SMOOTH_MM = 0.0634
# Steeper normals are outside the range of the fit: 28 degrees.
_STEEPEST = 0.8
_NEWTON_STEPS = 4
# Pixels that differ less from the free gel, in levels summed over the channels, are untouched: grain stays below.
_UNTOUCHED_LEVELS = 15.0
_LEAST_UNTOUCHED = 0.02
# A flat top bends no light either and lies higher: the lowest of those pixels are the free gel.
_LOWEST_PERCENT = 10.0


@dataclass(frozen=True, eq=False)
class Station:
    """The light of one station in its inspected region."""

    profile: SensorProfile
    region: Region
    free: F32
    """The gel without contact, float32 (h, w, 3) levels of the region."""

    @cached_property
    def field(self) -> Field:
        """The region's pixels."""
        return Field((self.region.width, self.region.height), self.profile.mm_per_pixel)

    def surface(self, rgb: U8) -> F32:
        """The gel's surface under a press, mm towards the camera, float32 (h, w); 0 where nothing is touched.

        rgb: uint8 (h, w, 3) of the region.
        """
        press = self._level(rgb)
        nx, ny = self._normals(press.transpose(2, 0, 1) - self._planes)
        upright = np.asarray(np.sqrt(1 - nx * nx - ny * ny), np.float32)
        surface = _integrate(-nx / upright, -ny / upright, self.field.mm_per_px)
        difference = cv2.blur(np.abs(press - self.free).sum(axis=2), (9, 9))
        untouched = difference < _UNTOUCHED_LEVELS
        known = surface[untouched] if untouched.mean() > _LEAST_UNTOUCHED else surface
        lowest = np.percentile(known, _LOWEST_PERCENT)
        return np.asarray(np.maximum(surface - lowest, 0), np.float32)

    def pressure(self, surface_mm: F32) -> F32:
        """Return how hard each point of the gel is pushed, in mm: z - L^2 laplacian(z), 0 where nothing holds it up.

        Source: the bed of springs of `calibration.simulator.gel`, with the mean of its two lengths.
        """
        length = (1 - GEL.long_share) * GEL.short_mm + GEL.long_share * GEL.long_mm
        sx, sy = (0.25 / m for m in self.field.mm_per_px)
        smooth = cv2.GaussianBlur(surface_mm, (0, 0), sx, sigmaY=sy)
        dx, dy = self.field.mm_per_px
        bent = cv2.Sobel(smooth, cv2.CV_32F, 2, 0) / (4 * dx * dx) + cv2.Sobel(smooth, cv2.CV_32F, 0, 2) / (
            4 * dy * dy
        )
        return np.asarray(smooth - length * length * bent, np.float32)

    def light(self, surface_mm: F32) -> F32:
        """The picture of a gel with this surface, float32 (h, w, 3) levels, without noise, grain and dust."""
        nx, ny = optics.normals(surface_mm, self.field)
        planes = optics.illumination(nx, ny, *self._lamps)
        planes = optics.shadows(planes, surface_mm, self.field)
        planes = optics.specular(planes, nx, ny)
        planes = camera.vignette(planes, self._falloff)
        return np.ascontiguousarray(camera.lens_blur(planes, self.field).transpose(1, 2, 0))

    @cached_property
    def _whole(self) -> Field:
        return Field(self.profile.size, self.profile.mm_per_pixel)

    @cached_property
    def _falloff(self) -> F32:
        return np.ascontiguousarray(self.region.crop(camera.lens_falloff(self._whole)))

    @cached_property
    def _planes(self) -> F32:
        return np.ascontiguousarray(self.free.transpose(2, 0, 1))

    @cached_property
    def _response(self) -> F32:
        """Levels per nx and ny as the camera sees them, float32 (3, 2, h, w)."""
        whole = sensor_appearance.response(_UNIT, self._whole)
        region = self.region
        return whole[..., region.y : region.y + region.height, region.x : region.x + region.width]

    @cached_property
    def _lamps(self) -> tuple[F32, F32, F32]:
        """Free gel, response and curvature before the lens, as `optics.illumination` takes them."""
        return self._planes / self._falloff, self._response / self._falloff, _CURVATURE

    def _level(self, rgb: U8) -> F32:
        """The press at the free gel's brightness: lamps drift, and untouched gel shows by how much."""
        press = rgb.astype(np.float32)
        gain = np.median(press / np.maximum(self.free, 1), axis=(0, 1))
        return np.asarray(press / gain.astype(np.float32), np.float32)

    def _normals(self, difference: F32) -> tuple[F32, F32]:
        """nx and ny that explain the colours, least squares over the channels weighted by their noise.

        difference: float32 (3, h, w). The quadratic part is put on the other side, Newton-like.
        """
        sigma = tuple(_SMOOTH_MM / m for m in self.field.mm_per_px)
        seen = np.stack([cv2.GaussianBlur(plane, (0, 0), sigma[0], sigmaY=sigma[1]) for plane in difference])
        weights = 1 / np.square(np.array(NOISE_SD, np.float32))
        (a, b), (_, d) = np.einsum("c,cihw,cjhw->ijhw", weights, self._response, self._response)
        nx, ny = np.zeros_like(a), np.zeros_like(a)
        for _ in range(_NEWTON_STEPS):
            bent = np.einsum("ck,khw->chw", _CURVATURE, np.stack([nx * nx, ny * ny, nx * ny]))
            u, v = np.einsum("c,cihw,chw->ihw", weights, self._response, seen - bent)
            nx, ny = (d * u - b * v) / (a * d - b * b), (a * v - b * u) / (a * d - b * b)
            shrink = np.minimum(1, _STEEPEST / np.maximum(np.hypot(nx, ny), 1e-6))
            nx, ny = nx * shrink, ny * shrink
        return nx, ny


# One response is known; the units differ in the colours of their free gel.
_UNIT = sensor_appearance.SENSORS["unit_b"]
_CURVATURE = _UNIT.slope_response[:, 12:].astype(np.float32)


def _integrate(slope_x: F32, slope_y: F32, mm_per_px: tuple[float, float]) -> F32:
    """The surface with these slopes, least squares; its mean is 0.

    Source: Frankot and Chellappa (1988) with Neumann borders. An odd number of pixels is extended by one.
    """
    h, w = slope_x.shape
    pad = ((0, h % 2), (0, w % 2))
    p, q = (np.pad(slope.astype(np.float64), pad, mode="edge") for slope in (slope_x, slope_y))
    return np.asarray(integrate(p, q, mm_per_px)[:h, :w], np.float32)
