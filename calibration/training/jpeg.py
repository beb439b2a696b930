"""JPEG compression of batches in torch: colour at half resolution, 8x8 blocks, rounded cosines.

The camera sends JPEG, so every real frame has its artefacts. No gradient passes through it. Ref: ITU-T T.81 (1992),
A.3.3 and tables K.1 and K.2; the scale by quality is the Independent JPEG Group's.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

__all__ = ["compressed"]

_BLOCK = 8
# T.81 table K.1, luminance, row by row; K.2, chrominance, is 99 except for its corner of low frequencies.
_LUMINANCE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)
_CHROMINANCE_CORNER = ((17, 18, 24, 47), (18, 21, 26, 66), (24, 26, 56, 99), (47, 66, 99, 99))
# JFIF: grey levels of red, green and blue to luminance and two differences of colour, and back.
_TO_YCC = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
_TO_RGB = ((1.0, 0.0, 1.402), (1.0, -0.344136, -0.714136), (1.0, 1.772, 0.0))


def compressed(planes: Tensor, quality: Tensor) -> Tensor:
    """Planes (n, 3, h, w) in grey levels 0 to 255 after JPEG compression. quality: (n,), 50 to 100.

    h and w are multiples of 16.
    """
    to_ycc, to_rgb = (torch.tensor(m, device=planes.device) for m in (_TO_YCC, _TO_RGB))
    ycc = torch.einsum("ij,njhw->nihw", to_ycc, planes)
    light = _rounded(ycc[:, :1] - 128, _steps(_luminance(planes.device), quality)) + 128
    colour = _rounded(F.avg_pool2d(ycc[:, 1:], 2), _steps(_chrominance(planes.device), quality))
    size = list(planes.shape[-2:])
    colour = F.interpolate(colour, size=size, mode="bilinear", align_corners=False)
    rgb = torch.einsum("ij,njhw->nihw", to_rgb, torch.cat([light.round(), colour.round()], dim=1))
    return rgb.round().clamp(0, 255)


def _luminance(device: torch.device) -> Tensor:
    return torch.tensor(_LUMINANCE, dtype=torch.float32, device=device)


def _chrominance(device: torch.device) -> Tensor:
    table = torch.full((_BLOCK, _BLOCK), 99.0, device=device)
    table[:4, :4] = torch.tensor(_CHROMINANCE_CORNER, dtype=torch.float32, device=device)
    return table


def _steps(table: Tensor, quality: Tensor) -> Tensor:
    """Rounding steps (n, 8, 8) at qualities of at least 50."""
    scale = 200 - 2 * quality[:, None, None]
    return ((table * scale + 50) / 100).floor().clamp(1, 255)


def _rounded(planes: Tensor, steps: Tensor) -> Tensor:
    """Planes (n, c, h, w) with the cosines of each block rounded to multiples of the steps."""
    n, c, h, w = planes.shape
    cosines = _cosines(planes.device)
    blocks = planes.view(n, c, h // _BLOCK, _BLOCK, w // _BLOCK, _BLOCK).transpose(3, 4)
    step = steps[:, None, None, None]
    found = ((cosines @ blocks @ cosines.T) / step).round() * step
    return (cosines.T @ found @ cosines).transpose(3, 4).reshape(n, c, h, w)


def _cosines(device: torch.device) -> Tensor:
    """The orthonormal cosine transform, rows by frequency."""
    k = torch.arange(_BLOCK, dtype=torch.float32, device=device)
    table = torch.cos(math.pi / _BLOCK * (k[None] + 0.5) * k[:, None]) * math.sqrt(2 / _BLOCK)
    table[0] /= math.sqrt(2)
    return table
