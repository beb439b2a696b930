"""How light makes a picture of the gel's surface: slopes, three lights, their shadows and their gloss.

Planes are float32 (3, h, w) in grey levels 0 to 255, channel order red, green, blue; a function that adds to them
changes them in place and returns them.
"""

import cv2
import numpy as np

from calibration.simulator.field_of_view import Field
from edge.core.arrays import F32

__all__ = ["headlight", "illumination", "normals", "raise_planes", "shadows", "specular"]

# Where each light shines from, as a step in (x, y): red from the top of the picture, green from the right, blue from
# below (measured on three units: a ball is red on top, green right, blue below).
LIGHTS = ((0, -1), (1, 0), (0, 1))
# The lights are low at the gel's side: about 25 degrees above it (assumed; the maker does not publish it).
LIGHT_RISE = 0.47
# Reach of a shadow that is followed; an imprint 0.5 mm high throws 1.1 mm at this elevation.
SHADOW_REACH_MM = 1.2
SHADOW_STEPS = 8
# Height over which a shadow's edge goes from none to full: the lights are bars, not points.
PENUMBRA_MM = 0.06
# The maker's coat is nearly Lambertian; the little gloss that is seen on steep flanks is a broad lobe.
GLOSS_DOUBLINGS = 3
GLOSS_TILT = 0.55
# The headlight's level: mid grey, so that neither slopes nor noise clip.
_HEADLIGHT_LEVEL = 128.0


def normals(surface_mm: F32, field: Field) -> tuple[F32, F32]:
    """The horizontal parts of the surface normal, nx and ny, float32 (h, w), each in (-1, 1).

    A bulge towards the camera has nx > 0 on its right and ny > 0 on its lower side.
    """
    scale_x, scale_y = -1 / (8 * field.mm_per_px[0]), -1 / (8 * field.mm_per_px[1])
    slope_x = cv2.Sobel(surface_mm, cv2.CV_32F, 1, 0, ksize=3, scale=scale_x, borderType=cv2.BORDER_REPLICATE)
    slope_y = cv2.Sobel(surface_mm, cv2.CV_32F, 0, 1, ksize=3, scale=scale_y, borderType=cv2.BORDER_REPLICATE)
    length = cv2.sqrt(slope_x * slope_x + slope_y * slope_y + 1)
    return np.asarray(slope_x / length, dtype=np.float32), np.asarray(slope_y / length, dtype=np.float32)


def headlight(nx: F32, ny: F32) -> F32:
    """The picture when a scene names no lights: a white lamp at the camera on a Lambertian coat."""
    level = _HEADLIGHT_LEVEL * cv2.sqrt(1 - nx * nx - ny * ny)
    return np.stack([level, level, level]).astype(np.float32, copy=False)


def illumination(nx: F32, ny: F32, free_gel: F32, per_normal: F32, curvature: F32) -> F32:
    """Three coloured lights from three sides, falling off across the gel.

    free_gel: planes of the untouched gel. per_normal: float32 (3, 2, h, w), grey levels per nx and ny. curvature: (3,
    3), grey levels per nx^2, ny^2 and nx ny. Source: photometric stereo, linear in the normal with a quadratic part;
    the tables are fits to real ball presses (see `sensor_appearance`).
    """
    squares = (nx * nx, ny * ny, nx * ny)
    planes = np.empty_like(free_gel)
    for c in range(3):
        plane = planes[c]
        np.multiply(per_normal[c, 0], nx, out=plane)
        plane += per_normal[c, 1] * ny
        for factor, square in zip(curvature[c].tolist(), squares, strict=True):
            cv2.scaleAdd(square, factor, plane, dst=plane)
        plane += free_gel[c]
    return np.maximum(planes, 0, out=planes)


def raise_planes(planes: F32, surface_mm: F32, per_mm: F32) -> F32:
    """Add to the planes what a raised gel returns more, being nearer to the lights: float32 (3, h, w).

    per_mm: float32 (3, h, w), grey levels per mm. Fitted to ball presses, whose flat middle is brighter than the free
    gel; without it the error inside contact is 1.4 to 1.5 times as large (docs/simulator.md).
    """
    for plane, factor in zip(planes, per_mm, strict=True):
        plane += factor * surface_mm
    return np.maximum(planes, 0, out=planes)


# A fully shadowed point keeps this share of that colour: light also comes back from the walls. FOTS uses 0.65.
_SHADOW_KEEPS = 0.65


def shadows(planes: F32, surface_mm: F32, field: Field) -> F32:
    """The planes with each light's cast shadow: a point is darker where the surface between it and the light hides it.

    Source: height-field ray marching with the rise of one ray per light; the three lights are axis-parallel.
    """
    if not surface_mm.any():
        return planes
    # A shadow is soft, so half resolution is enough.
    half = (max(2, field.size[0] // 2), max(2, field.size[1] // 2))
    height = np.asarray(cv2.resize(surface_mm, half, interpolation=cv2.INTER_AREA), dtype=np.float32)
    for plane, (dx, dy) in zip(planes, LIGHTS, strict=True):
        spacing = field.extent_mm[0] / half[0] if dx else field.extent_mm[1] / half[1]
        hidden = _hidden_by(height, dx, dy, spacing)
        shade = np.clip(hidden / PENUMBRA_MM, 0, 1)
        shade = cv2.GaussianBlur(shade, (5, 5), 1.0)
        factor = cv2.resize(shade, field.size, interpolation=cv2.INTER_LINEAR)
        plane *= 1 - (1 - _SHADOW_KEEPS) * factor
    return planes


def _hidden_by(height: F32, dx: int, dy: int, spacing: float) -> F32:
    """Measure in mm how far the ray towards the light passes below the surface, float32 (h, w), 0 where it is free."""
    hidden = np.zeros_like(height)
    rows, columns = height.shape
    for k in range(1, SHADOW_STEPS + 1):
        distance_mm = SHADOW_REACH_MM * k / SHADOW_STEPS
        step = round(distance_mm / spacing)
        if step == 0 or step >= (columns if dx else rows):
            continue
        here = _slices(rows, columns, -dx * step, -dy * step)
        there = _slices(rows, columns, dx * step, dy * step)
        over = height[there] - height[here] - step * spacing * LIGHT_RISE
        np.maximum(hidden[here], over, out=hidden[here])
    return hidden


def _slices(rows: int, columns: int, dx: int, dy: int) -> tuple[slice, slice]:
    return (slice(max(dy, 0), rows + min(dy, 0)), slice(max(dx, 0), columns + min(dx, 0)))


_GLOSS_LEVEL = 22.0


def specular(planes: F32, nx: F32, ny: F32) -> F32:
    """The planes with each light's gloss: grey levels where the normal halves the angle between light and camera.

    Source: Blinn's half-vector lobe, exponent 8, at most 22 grey levels. The reflection of flat gel is already in its
    colour, so only the change is added. The strength is estimated by eye on real threads.
    """
    nz = cv2.sqrt(1 - nx * nx - ny * ny)
    half_z = np.float32((1 - GLOSS_TILT**2) ** 0.5)
    flat = float(half_z) ** (2**GLOSS_DOUBLINGS)
    for plane, (dx, dy) in zip(planes, LIGHTS, strict=True):
        towards = nx * dx if dx else ny * dy
        lobe = np.maximum(towards * GLOSS_TILT + nz * half_z, 0)
        for _ in range(GLOSS_DOUBLINGS):
            lobe *= lobe
        plane += _GLOSS_LEVEL * (lobe - flat)
    return planes
