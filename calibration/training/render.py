"""The simulator's effects for batches, in torch, on any device.

Same models and numbers as `calibration.simulator` (gel, optics, camera, gel_surface); a test compares both on equal
height maps. Each function takes tensors (n, h, w) in mm or planes (n, 3, h, w) in grey levels. Spacing is (x, y) in mm
per pixel and common to a batch. No gradient passes through it.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from calibration.simulator.constants import (
    COARSEST_MM,
    COAT_SIGMA_MM,
    CROP_MM,
    GLOSS_DOUBLINGS,
    GLOSS_TILT,
    GRAIN_FREE,
    GRAIN_SIGMA_MM,
    LIGHT_RISE,
    LIGHTS,
    LONG_FINEST_MM,
    LONG_MM,
    LONG_SHARE,
    NOISE_LEVEL,
    NOISE_SD,
    PENUMBRA_MM,
    SHADOW_REACH_MM,
    SHADOW_STEPS,
    SHORT_MM,
    SWEEPS,
)

__all__ = [
    "BatchAppearance",
    "Spacing",
    "blur",
    "deform",
    "free_gel",
    "gloss",
    "grain",
    "lens",
    "normals",
    "quantise",
    "sensor_noise",
    "shade",
    "shadows",
    "slopes",
    "unit_grid",
]

Spacing = tuple[float, float]


@dataclass(frozen=True)
class BatchAppearance:
    """The colours of n sensors over a grid."""

    free: Tensor
    """(n, 3, h, w), the untouched gel."""
    per_normal: Tensor
    """(n, 3, 2, h, w), grey levels per nx and ny."""
    curvature: Tensor
    """(n, 3, 3), grey levels per nx^2, ny^2 and nx ny."""


def blur(x: Tensor, sigma_px: tuple[float, float], reach: float = 2.5, mode: str = "replicate") -> Tensor:
    """Gaussian along x and y with sigmas in pixels, kernels of 2 ceil(reach sigma) + 1; x: (n, h, w)."""
    for axis, sigma in ((2, sigma_px[0]), (1, sigma_px[1])):
        radius = math.ceil(reach * sigma)
        pad = (radius, radius, 0, 0) if axis == 2 else (0, 0, radius, radius)
        wide = F.pad(x[:, None], pad, mode=mode)[:, 0]
        size = x.shape[axis]
        # Shifted sums: a one-channel convolution is many times slower on a CPU.
        weights = [math.exp(-0.5 * (k / sigma) ** 2) for k in range(-radius, radius + 1)]
        total = sum(weights)
        x = wide.narrow(axis, 0, size) * (weights[0] / total)
        for k, weight in enumerate(weights[1:], start=1):
            x.add_(wide.narrow(axis, k, size), alpha=weight / total)
    return x


def deform(obstacle_mm: Tensor, spacing: Spacing, stiffness: float = 1.0) -> Tensor:
    """The gel's surface over rigid obstacles, (n, h, w) in mm: the mean of two membranes on springs.

    stiffness multiplies both relaxation lengths: gels differ.
    """
    short = _membrane(obstacle_mm, spacing, SHORT_MM * stiffness, 0.0)
    long = _membrane(obstacle_mm, spacing, LONG_MM * stiffness, LONG_FINEST_MM)
    surface = (1 - LONG_SHARE) * short + LONG_SHARE * long
    return blur(surface, (COAT_SIGMA_MM / spacing[0], COAT_SIGMA_MM / spacing[1]))


def _membrane(obstacle: Tensor, spacing: Spacing, relaxation_mm: float, finest_mm: float) -> Tensor:
    """The membrane of one relaxation length, solved from coarse spacings down to `finest_mm`."""
    levels = max(0, math.ceil(math.log2(COARSEST_MM / min(spacing))))
    surface: Tensor | None = None
    for level in range(levels, -1, -1):
        shrink = 2**level
        target = obstacle if level == 0 else F.avg_pool2d(obstacle[:, None], shrink)[:, 0]
        if surface is None:
            surface = target
        else:
            size = list(target.shape[-2:])
            surface = F.interpolate(surface[:, None], size=size, mode="bilinear", align_corners=False)[:, 0]
        coarse = (spacing[0] * shrink, spacing[1] * shrink)
        if max(coarse) < finest_mm:
            continue
        sigma = 1.1 * max(coarse)
        decay = math.exp(-0.5 * (sigma / relaxation_mm) ** 2)
        for _ in range(SWEEPS[min(levels - level, len(SWEEPS) - 1)]):
            surface = torch.maximum(blur(surface, (sigma / coarse[0], sigma / coarse[1])) * decay, target)
    assert surface is not None
    return torch.maximum(surface, obstacle)


def slopes(surface_mm: Tensor, spacing: Spacing) -> tuple[Tensor, Tensor]:
    """-dz/dx and -dz/dy by Sobel, (n, h, w) each: positive on the right and lower sides of a bulge."""
    z = F.pad(surface_mm[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    rows = z[:, :-2] + 2 * z[:, 1:-1] + z[:, 2:]
    columns = z[:, :, :-2] + 2 * z[:, :, 1:-1] + z[:, :, 2:]
    along_x = (rows[:, :, :-2] - rows[:, :, 2:]) / (8 * spacing[0])
    along_y = (columns[:, :-2] - columns[:, 2:]) / (8 * spacing[1])
    return along_x, along_y


def normals(slope_x: Tensor, slope_y: Tensor) -> tuple[Tensor, Tensor]:
    """nx and ny of the unit normal."""
    length = torch.sqrt(slope_x * slope_x + slope_y * slope_y + 1)
    return slope_x / length, slope_y / length


def unit_grid(
    side: int, spacing: Spacing, centre: tuple[float, float], device: torch.device
) -> tuple[Tensor, Tensor]:
    """u and v over the region, (h, w) each; the whole crop spans -1 to 1. centre: of the region, in u and v."""
    at = torch.arange(side, device=device, dtype=torch.float32) + (0.5 - side / 2)
    u = (at * (spacing[0] * 2 / CROP_MM[0]) + centre[0]).clamp(-1.02, 1.02)
    v = (at * (spacing[1] * 2 / CROP_MM[1]) + centre[1]).clamp(-1.02, 1.02)
    return u[None, :].expand(side, side), v[:, None].expand(side, side)


def free_gel(tables: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Planes (n, 3, h, w) of the untouched gel from (n, 3, 15) logarithmic polynomials of degree 4."""
    terms = torch.stack([u**i * v**j for i in range(5) for j in range(5 - i)])
    return torch.exp(torch.einsum("nck,khw->nchw", tables, terms))


def per_normal(tables: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Grey levels per nx and ny, (n, 3, 2, h, w), from the first 12 columns of (n, 3, 15)."""
    terms = torch.stack([torch.ones_like(u), u, v, u * u, v * v, u * v])
    return torch.einsum("ncdk,khw->ncdhw", tables[:, :, :12].unflatten(2, (2, 6)), terms)


def shade(nx: Tensor, ny: Tensor, appearance: BatchAppearance) -> Tensor:
    """Planes under the three lights, not yet below 0."""
    linear = appearance.per_normal[:, :, 0] * nx[:, None] + appearance.per_normal[:, :, 1] * ny[:, None]
    squares = torch.stack([nx * nx, ny * ny, nx * ny], dim=1)
    return (linear + torch.einsum("nck,nkhw->nchw", appearance.curvature, squares) + appearance.free).clamp(
        min=0
    )


def shadows(planes: Tensor, surface_mm: Tensor, keeps: Tensor, spacing: Spacing) -> Tensor:
    """The planes with each light's cast shadow; keeps: (n,), the share of light in full shadow."""
    height = F.avg_pool2d(surface_mm[:, None], 2)[:, 0]
    factors = []
    for dx, dy in LIGHTS:
        hidden = _hidden_by(height, dx, dy, 2 * (spacing[0] if dx else spacing[1]))
        soft = blur((hidden / PENUMBRA_MM).clamp(0, 1), (1.0, 1.0), reach=2.0, mode="reflect")
        size = list(planes.shape[-2:])
        factors.append(F.interpolate(soft[:, None], size=size, mode="bilinear", align_corners=False)[:, 0])
    return planes * (1 - (1 - keeps[:, None, None, None]) * torch.stack(factors, dim=1))


def _hidden_by(height: Tensor, dx: int, dy: int, spacing: float) -> Tensor:
    """Return the mm by which the ray towards the light passes below the surface; 0 where it is free."""
    hidden = torch.zeros_like(height)
    rows, columns = height.shape[-2:]
    for k in range(1, SHADOW_STEPS + 1):
        step = round(SHADOW_REACH_MM * k / SHADOW_STEPS / spacing)
        if step == 0 or step >= (columns if dx else rows):
            continue
        there = torch.roll(height, (-dy * step, -dx * step), (1, 2))
        over = there - height - step * spacing * LIGHT_RISE
        # Values that rolled in from the opposite side are not neighbours.
        if dx > 0:
            over[:, :, columns - step :] = 0
        elif dy > 0:
            over[:, rows - step :] = 0
        else:
            over[:, :step] = 0
        hidden = torch.maximum(hidden, over)
    return hidden


def gloss(planes: Tensor, nx: Tensor, ny: Tensor, level: Tensor) -> Tensor:
    """The planes with each light's broad lobe, Blinn exponent 8; level: (n,), grey levels at its peak."""
    nz = torch.sqrt((1 - nx * nx - ny * ny).clamp(min=0))
    half_z = math.sqrt(1 - GLOSS_TILT**2)
    lobes = []
    for dx, dy in LIGHTS:
        lobe = ((nx * dx if dx else ny * dy) * GLOSS_TILT + nz * half_z).clamp(min=0)
        lobes.append(lobe ** (2**GLOSS_DOUBLINGS) - half_z ** (2**GLOSS_DOUBLINGS))
    return planes + level[:, None, None, None] * torch.stack(lobes, dim=1)


def grain(planes: Tensor, surface_mm: Tensor, white: Tensor, levels: Tensor, spacing: Spacing) -> Tensor:
    """The planes with the coat's speckle, about three times as strong on a stretched coat.

    white: unit noise (n, h, w), blurred here to a flake's size. levels: (n,), sd in grey levels on a stretched coat.
    """
    texture = blur(white, (GRAIN_SIGMA_MM / spacing[0], GRAIN_SIGMA_MM / spacing[1]), reach=4.0)
    texture = texture / texture.std(dim=(1, 2), keepdim=True)
    stretched = (surface_mm / 0.1).clamp(0, 1)
    speckle = texture * (GRAIN_FREE + (1 - GRAIN_FREE) * stretched) * levels[:, None, None]
    return planes + speckle[:, None]


def lens(planes: Tensor, sigma_mm: float, spacing: Spacing) -> Tensor:
    """The planes through a lens of this point spread on the gel."""
    n, c, h, w = planes.shape
    sigma = (sigma_mm / spacing[0], sigma_mm / spacing[1])
    return blur(planes.reshape(n * c, h, w), sigma).view(n, c, h, w)


def sensor_noise(planes: Tensor, white: Tensor, strength: Tensor) -> Tensor:
    """The planes with the camera's noise; white: unit noise of the planes' shape. strength: (n,), 1 as measured."""
    variance = torch.tensor(NOISE_SD, device=planes.device).view(1, 3, 1, 1) ** 2 / 2
    sd = torch.sqrt(variance * (planes.clamp(min=0) / NOISE_LEVEL + 1))
    return planes + white * sd * strength[:, None, None, None]


def quantise(planes: Tensor) -> Tensor:
    """Whole grey levels from 0 to 255, still float32."""
    return planes.round().clamp(0, 255)
