"""How the gel gives way: a membrane on an elastic bed, stretched over the part, and the imprint that stays."""

import math

import cv2
import numpy as np

from calibration.simulator.field import F32, Field

__all__ = ["deformation", "residual_imprint"]

# Length over which the gel rises back to its free height beside an edge. Real frames show a soft halo about 10
# pixels wide at 320x240 (0.6 mm) that has died away by twice that.
RELAXATION_MM = 0.45

# The coat is stiff over this length: finer detail than this never shows. About a pixel at 640x480.
COAT_SIGMA_MM = 0.035

# Below this spacing a coarser level of the pyramid tells nothing more.
COARSEST_MM = 0.28

_SWEEPS = 4


def deformation(obstacle_mm: F32, field: Field) -> F32:
    """The gel's surface over a rigid part, in mm towards the camera, float32 (h, w).

    The gel is a stretched membrane on a bed of springs: away from the part z - L^2 (laplacian of z) = 0, on the part
    z = obstacle, nowhere below it. Solved from coarse to fine; one sweep is a Gaussian step whose fixed point decays
    by exp(-distance / L), then the obstacle is put back. Source: the obstacle problem of a Winkler membrane, with
    the pyramid and the restored contact that the Taxim simulator uses for the same purpose.
    """
    if not obstacle_mm.any():
        return obstacle_mm.copy()
    finest = min(field.mm_per_px)
    levels = max(0, math.ceil(math.log2(COARSEST_MM / finest)))
    surface = None
    for level in range(levels, -1, -1):
        shrink = 2**level
        size = (max(2, field.size[0] // shrink), max(2, field.size[1] // shrink))
        target = obstacle_mm if level == 0 else cv2.resize(obstacle_mm, size, interpolation=cv2.INTER_AREA)
        surface = target if surface is None else cv2.resize(surface, size, interpolation=cv2.INTER_LINEAR)
        spacing = (field.extent_mm[0] / size[0], field.extent_mm[1] / size[1])
        surface = _relax(np.asarray(surface, dtype=np.float32), np.asarray(target, dtype=np.float32), spacing)
    assert surface is not None
    return _blur(surface, COAT_SIGMA_MM, field.mm_per_px)


def _relax(surface: F32, obstacle: F32, spacing: tuple[float, float]) -> F32:
    sigma = 1.1 * max(spacing)
    decay = math.exp(-0.5 * (sigma / RELAXATION_MM) ** 2)
    for _ in range(_SWEEPS if max(spacing) > 0.06 else 2):
        surface = _blur(surface, sigma, spacing)
        cv2.multiply(surface, decay, dst=surface)
        cv2.max(surface, obstacle, dst=surface)
    return surface


def _blur(image: F32, sigma_mm: float, spacing: tuple[float, float]) -> F32:
    sx, sy = sigma_mm / spacing[0], sigma_mm / spacing[1]
    size = (2 * math.ceil(2.5 * sx) + 1, 2 * math.ceil(2.5 * sy) + 1)
    return np.asarray(
        cv2.GaussianBlur(image, size, sx, sigmaY=sy, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
    )


def residual_imprint(surface_mm: F32, previous_mm: F32, since_release_s: float) -> F32:
    """The surface with what is left of the previous press: 12 % of it at once, half of that gone within a second.

    Measured on three public videos: 6 to 25 % of the contact signal remains after 0.5 s, 5 to 19 % after 2 to 3 s.
    """
    share = 0.06 + 0.06 * math.exp(-max(0.0, since_release_s) / 1.0)
    return np.asarray(np.maximum(surface_mm, np.float32(share) * previous_mm), dtype=np.float32)
