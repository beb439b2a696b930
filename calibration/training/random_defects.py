"""Random defects for training, as batches: bells, flattened places, filled relief and rough patches on touched spots.

Separate from `calibration.simulator.defects`, whose eight kinds are reserved for evaluation.
"""

import math

import torch
from torch import Tensor

from calibration.training.random_parts import ramp, turned
from calibration.training.random_sampling import Draws
from calibration.training.render import Spacing, blur

__all__ = ["damaged"]

_SLOTS = 3
# Shares of bells, flattened places, filled relief and rough patches.
_KINDS = (0.5, 0.2, 0.15, 0.15)
# A defect starts where the part enters the gel by at least this share of the press.
_TOUCH_SHARE = 0.25


def damaged(
    draws: Draws, height: Tensor, depth_mm: Tensor, x: Tensor, y: Tensor, spacing: Spacing, scale: float
) -> Tensor:
    """Heights (n, h, w) with up to three defects each; nine of ten samples have at least one.

    depth_mm: (n,) of the press, so that the defects are in the contact. x, y: pixel coordinates in mm, (h, w).
    """
    touched = (height > -(1 - _TOUCH_SHARE) * depth_mm[:, None, None]).flatten(1).float() + 1e-6
    filled = blur(height.clamp(min=-1.2), (0.5 * scale / spacing[0], 0.5 * scale / spacing[1]))
    for slot in range(_SLOTS):
        spot = draws.pick(touched)
        u, v = turned(
            x[None] - x.flatten()[spot][:, None, None],
            y[None] - y.flatten()[spot][:, None, None],
            draws.uniform(0, math.pi, len(height)),
        )
        height = _one(draws, height, filled, u, v, 0.9 if slot == 0 else 0.35, scale)
    return height


def _one(
    draws: Draws, height: Tensor, filled: Tensor, u: Tensor, v: Tensor, share: float, scale: float
) -> Tensor:
    """One defect per sample; u, v: coordinates along and across it, (n, h, w)."""
    n = len(height)

    def per(values: Tensor) -> Tensor:
        return values[:, None, None]

    size = draws.log_uniform(0.15, 1.6, n) * scale
    aspect = draws.log_uniform(0.12, 1.0, n)
    v = v - per(draws.chance(0.4, n) * draws.normal(0.15, n) / size) * u * u
    kind = draws.kind(_KINDS, n)
    amount = draws.chance(share, n) * draws.log_uniform(0.025, 0.5, n)

    bell_amount = amount * (kind == 0)
    r = torch.sqrt((u / per(size)) ** 2 + (v / per(size * aspect)) ** 2)
    sign = 1 - 1.5 * draws.chance(0.65, n)  # 1 or -0.5: raised metal shows at a smaller height
    lips = draws.chance(0.5, n) * draws.uniform(0, 0.25, n)
    bell = per(sign) * 2 * ramp(1 - r) + per(lips) * torch.exp(-(((r - 1.15) / 0.25) ** 2))
    height = height + per(bell_amount.clamp(max=0.35)) * bell.clamp(-1, 0.7)

    inside = ramp((1.2 - u.abs() / per(size)) * 3) * ramp(
        (1.2 - v.abs() / per(size * aspect.clamp(min=0.4))) * 3
    )
    local_top = torch.where(inside > 0.3, height, torch.full_like(height, -9.0)).amax(dim=(1, 2))
    plane = per(local_top - amount) + per(draws.chance(0.5, n) * draws.normal(0.2, n)) * u
    flattened = height - inside * (height - plane).clamp(min=0)
    height = torch.where(per((kind == 1) & (amount > 0)), flattened, height)

    is_filled = (kind == 2) & (amount > 0)
    height = height + per(is_filled * draws.uniform(0.3, 1.0, n)) * inside * (filled - height)

    rough = blur(draws.normal(1.0, *height.shape), (1.2, 1.2)) * 3.0
    return height + per(amount.clamp(max=0.2) * (kind == 3)) * 0.3 * inside * rough
