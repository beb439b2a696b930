"""How the gel deforms: membranes on an elastic bed, stretched over the part, and the residual imprint."""

import math
from typing import Annotated

import cv2
import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked

from calibration.simulator.field_of_view import Field as View
from edge.core.arrays import F32

__all__ = ["GEL", "Gel", "deformation", "residual_imprint"]

# The coat is stiff over this length: finer detail than this never shows. About a pixel at 640x480.
COAT_SIGMA_MM = 0.035
# Below this spacing a coarser level of the pyramid adds nothing.
COARSEST_MM = 0.28
# The long membrane is smooth: it is solved down to this spacing only.
LONG_FINEST_MM = 0.06
# Sweeps from the coarsest level to the finest, the last one repeated: coarse sweeps reach far and are cheap.
SWEEPS = (48, 20, 8, 3)


@checked(frozen=True, config=ConfigDict(extra="forbid"))
class Gel:
    """How a gel gives way: two relaxation lengths in mm, and the share of the long one."""

    # Near an edge the gel first drops steeply (the tension of its coat), then rises far out (the bulk of a pad 4.25 mm
    # thick). With these the slope around 51 real ball presses agrees within 2 grey levels from 0.7 mm inside the
    # contact to 2.3 mm outside it (docs/simulator.md).
    short_mm: Annotated[float, Field(gt=0, le=5)] = 0.25
    long_mm: Annotated[float, Field(gt=0, le=10)] = 1.1
    long_share: Annotated[float, Field(ge=0, le=1)] = 0.55

    def __post_init__(self) -> None:
        if self.short_mm > self.long_mm:
            raise ValueError(f"short_mm {self.short_mm} is not above long_mm {self.long_mm}")


GEL = Gel()
"""The gel of the shipped sensors."""


def deformation(obstacle_mm: F32, field: View, of: Gel = GEL) -> F32:
    """The gel's surface over a rigid part, in mm towards the camera, float32 (h, w).

    The mean of two stretched membranes on a bed of springs: away from the part z - L^2 (laplacian of z) = 0, on the
    part z = obstacle, nowhere lower; L is 0.25 and 1.1 mm for a gel that was not fitted. Source: the obstacle problem
    of a Winkler membrane, with the pyramid and the restored contact of the Taxim simulator. The sweeps round the corner
    at an edge: there the surface is up to a tenth of the height lower than the formula gives, at every resolution. The
    lengths were chosen with this included.
    """
    if not obstacle_mm.any():
        return obstacle_mm.copy()
    short = _membrane(obstacle_mm, field, of.short_mm, 0.0)
    long = _membrane(obstacle_mm, field, of.long_mm, LONG_FINEST_MM)
    surface = cv2.addWeighted(short, 1 - of.long_share, long, of.long_share, 0.0)
    return _blur(np.asarray(surface, dtype=np.float32), COAT_SIGMA_MM, field.mm_per_px)


def _membrane(obstacle: F32, field: View, relaxation_mm: float, finest_mm: float) -> F32:
    """The membrane of one relaxation length, solved from coarse spacings down to `finest_mm`.

    One sweep is a Gaussian step whose fixed point decays as exp(-distance / L), then the obstacle is put back.
    """
    levels = max(0, math.ceil(math.log2(COARSEST_MM / min(field.mm_per_px))))
    surface = None
    for level in range(levels, -1, -1):
        size = (max(2, field.size[0] >> level), max(2, field.size[1] >> level))
        target = (
            obstacle if level == 0 else np.asarray(cv2.resize(obstacle, size, interpolation=cv2.INTER_AREA))
        )
        surface = (
            target.copy() if surface is None else cv2.resize(surface, size, interpolation=cv2.INTER_LINEAR)
        )
        spacing = (field.extent_mm[0] / size[0], field.extent_mm[1] / size[1])
        if max(spacing) < finest_mm:
            continue
        sigma = 1.1 * max(spacing)
        decay = np.float32(math.exp(-0.5 * (sigma / relaxation_mm) ** 2))
        for _ in range(SWEEPS[min(levels - level, len(SWEEPS) - 1)]):
            surface = _blur(np.asarray(surface, dtype=np.float32), sigma, spacing)
            surface *= decay
            np.maximum(surface, target, out=surface)
    return np.maximum(np.asarray(surface, dtype=np.float32), obstacle)


def _blur(image: F32, sigma_mm: float, spacing: tuple[float, float]) -> F32:
    sx, sy = sigma_mm / spacing[0], sigma_mm / spacing[1]
    size = (2 * math.ceil(2.5 * sx) + 1, 2 * math.ceil(2.5 * sy) + 1)
    return np.asarray(
        cv2.GaussianBlur(image, size, sx, sigmaY=sy, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
    )


def residual_imprint(surface_mm: F32, previous_mm: F32, since_release_s: float) -> F32:
    """The surface with the rest of the previous press: 12 % of it at release, half of that after a second.

    Measured on three public videos: 6 to 25 % of the contact signal remains after 0.5 s, 5 to 19 % after 2 to 3 s.
    """
    share = 0.06 + 0.06 * math.exp(-max(0.0, since_release_s) / 1.0)
    return np.asarray(np.maximum(surface_mm, np.float32(share) * previous_mm), dtype=np.float32)
