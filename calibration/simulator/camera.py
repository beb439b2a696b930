"""Effects of the lens, the lamps' supply, the sensor and the camera's compression.

Planes are float32 (3, h, w) in grey levels, channel order red, green, blue. Each function changes them in place and
returns them: a copy would cost as much as the effect. Nothing else changes.
"""

import math
from functools import lru_cache
from statistics import NormalDist

import cv2
import numpy as np

from calibration.simulator.field_of_view import Field, grids
from edge.core.arrays import F32, U8

__all__ = [
    "CAMERA_QUALITY",
    "NOISE_LEVEL",
    "NOISE_SD",
    "encode_jpeg",
    "gel_rim",
    "jpeg",
    "led_drift",
    "lens_blur",
    "lens_falloff",
    "motion_blur",
    "noise",
    "noise_spread",
    "quantise",
    "vignette",
]

# Quality at which 3280x2464 frames are as large as the camera's (0.24 to 1.0 MB).
CAMERA_QUALITY = 85

# The pad is 25.25 x 20.75 mm in the maker's CAD; beyond it the camera sees the dark case.
_PAD_MM = (25.25, 20.75)
_RIM_LEVEL = 0.08

# Share of light a corner of the crop loses in the lens. Assumed: it cannot be separated from the lamps' own falloff.
_CORNER_LOSS = 0.25


@lru_cache(maxsize=4)
def gel_rim(field: Field) -> F32 | None:
    """The share of light seen at each point because of the pad's end, float32 (h, w); None where all is pad."""
    if field.extent_mm[0] < _PAD_MM[0] and field.extent_mm[1] < _PAD_MM[1]:
        return None
    x, y = grids(field)
    beyond = np.maximum(np.abs(x) - _PAD_MM[0] / 2, np.abs(y) - _PAD_MM[1] / 2)
    inside = np.clip(0.5 - beyond / 0.8, 0, 1)
    return np.asarray(_RIM_LEVEL + (1 - _RIM_LEVEL) * inside, dtype=np.float32)


@lru_cache(maxsize=4)
def lens_falloff(field: Field) -> F32:
    """The share of light that the lens passes, float32 (h, w): 1 at the centre, 0.75 at the crop's corners."""
    x, y = grids(field)
    r2 = (x * x + y * y) / (10.14**2 + 7.61**2)
    return np.asarray(1 / (1 + _CORNER_LOSS / (1 - _CORNER_LOSS) * r2), dtype=np.float32)


def vignette(planes: F32, falloff: F32) -> F32:
    """The planes darkened towards the corners by the lens (a smooth falloff with the square of the distance)."""
    planes *= falloff
    return planes


# The lens resolves about this: the sharpest real edges (a key's grooves) are two pixels wide at 320x240.
_LENS_SIGMA_MM = 0.035


def lens_blur(planes: F32, field: Field) -> F32:
    """The planes through a lens whose point spread has sigma 0.035 mm on the gel."""
    sx, sy = (_LENS_SIGMA_MM / m for m in field.mm_per_px)
    size = (2 * math.ceil(2.5 * sx) + 1, 2 * math.ceil(2.5 * sy) + 1)
    for plane in planes:
        cv2.GaussianBlur(plane, size, sx, dst=plane, sigmaY=sy, borderType=cv2.BORDER_REPLICATE)
    return planes


# Exposure that the maker recommended: 18 ms.
_EXPOSURE_S = 0.018


def motion_blur(planes: F32, velocity_mm_s: tuple[float, float], field: Field) -> F32:
    """The planes smeared by what the gel moves sideways during one exposure of 18 ms."""
    dx = velocity_mm_s[0] * _EXPOSURE_S / field.mm_per_px[0]
    dy = velocity_mm_s[1] * _EXPOSURE_S / field.mm_per_px[1]
    length = math.hypot(dx, dy)
    if length < 0.3:
        return planes
    reach = math.ceil(length / 2) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    for t in np.linspace(-0.5, 0.5, 4 * reach + 1):
        kernel += np.maximum(1 - np.abs(column - t * dx), 0) * np.maximum(1 - np.abs(row - t * dy), 0)
    kernel /= np.float32(kernel.sum(dtype=np.float64))
    for plane in planes:
        plane[:] = cv2.filter2D(plane, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    return planes


# Measured on a robot's ten runs of 100 presses: the mean level falls by 4 % over the first 6 to 7 cycles, then flat.
_WARM_UP = 0.04
_WARM_UP_S = 25.0
# Slow drift that remains, per colour (assumed).
_WANDER = 0.004
_WANDER_S = (140.0, 380.0)


def led_drift(planes: F32, time_s: float, rng: np.random.Generator) -> F32:
    """The planes with the lamps' level at this time after power on: warm-up, then a slow drift of each colour.

    The generator belongs to the session, so every frame of it has the same drift.
    """
    phase = rng.uniform(0, 2 * math.pi, (3, len(_WANDER_S)))
    warm = 1 + _WARM_UP * math.exp(-max(0.0, time_s) / _WARM_UP_S)
    for plane, phases in zip(planes, phase.tolist(), strict=True):
        waves = sum(
            math.sin(2 * math.pi * time_s / period + p) for period, p in zip(_WANDER_S, phases, strict=True)
        )
        plane *= warm + _WANDER * waves
    return planes


# Sd of a single frame in grey levels at the mean level, per channel R, G, B: measured 2.1-2.4, 1.4-1.7, 2.5-3.0 on
# PNG frames of the maker's resize. Half of the variance grows with the light.
NOISE_SD = (2.2, 1.5, 2.7)
NOISE_LEVEL = 100.0


@lru_cache(maxsize=1)
def _normal_quantiles() -> F32:
    """The normal distribution at the middle of each of 65536 equal shares, float32 (65536,): within 4.3 sd."""
    normal = NormalDist()
    upper = np.array([normal.inv_cdf(0.5 + (k + 0.5) / 65536) for k in range(32768)], dtype=np.float32)
    return np.concatenate([-upper[::-1], upper])


def noise(planes: F32, rng: np.random.Generator, spread: F32) -> F32:
    """The planes with the sensor's noise: a fixed part and a part that grows with the root of the light.

    spread: of `noise_spread`. Each value is looked up from 16 random bits in a table of quantiles: several times as
    fast as an exact draw.
    """
    # The bits of rng.bytes, eight times as fast.
    drawn = np.asarray(rng.bit_generator.random_raw(math.ceil(planes.size / 4)), dtype="<u8")
    bits, quantiles = drawn.view("<u2")[: planes.size].reshape(planes.shape), _normal_quantiles()
    for plane, sd, which in zip(planes, spread, bits, strict=True):
        values = quantiles.take(which, mode="wrap")  # nothing to wrap: the mode that copies no indices
        values *= sd
        plane += values
    return planes


def noise_spread(planes: F32, noise_sd: tuple[float, float, float] = NOISE_SD) -> F32:
    """The sd of the sensor's noise at each value, float32 (3, h, w). noise_sd: where the light is 100."""
    spread = np.maximum(planes, 0)
    for plane, sd in zip(spread, noise_sd, strict=True):
        half = 0.5 * sd * sd
        plane *= np.float32(half / NOISE_LEVEL)
        plane += np.float32(half)
    return np.sqrt(spread, out=spread)


def quantise(planes: F32) -> U8:
    """Whole grey levels, uint8 (h, w, 3), rounded and held to 0 to 255."""
    levels = np.rint(planes)
    np.clip(levels, 0, 255, out=levels)
    return np.asarray(cv2.merge(list(levels.astype(np.uint8))), np.uint8)


def encode_jpeg(rgb: U8, quality: int, size: tuple[int, int] | None = None) -> bytes:
    """The picture as JPEG bytes, scaled to (width, height) first. Errors: ValueError when the encoder refuses."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    if size is not None:
        bgr = cv2.resize(bgr, size, interpolation=cv2.INTER_LINEAR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"a picture of shape {rgb.shape} cannot be encoded as JPEG")
    return data.tobytes()


def jpeg(rgb: U8) -> U8:
    """The picture as it comes back from the camera's own compression at this size (quality 85, colour halved)."""
    bgr = cv2.imdecode(np.frombuffer(encode_jpeg(rgb, CAMERA_QUALITY), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
