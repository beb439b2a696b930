"""Random sensors for a batch: colours of gels, light of presses, noise of cameras, dots of marker gels."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from calibration.simulator.constants import DOT_KEEPS, DOT_PITCH_MM, DOT_RADIUS_MM, DOT_SPREAD_MM
from calibration.simulator.sensor_appearance import SENSORS
from calibration.training import render
from calibration.training.random_sampling import Draws
from calibration.training.render import BatchAppearance, Spacing

__all__ = ["TRAINING_UNITS", "DotLayout", "RandomSensors", "appearance", "gains", "under_dots"]

# Training mixes and varies these two measured sensors; `unit_c` is reserved for evaluation.
TRAINING_UNITS = ("unit_a", "unit_b")


@dataclass(frozen=True)
class DotLayout:
    """The dots of n tracking gels in mm. pitch, offset: (n, 2) along x and y. radius: (n,)."""

    pitch: Tensor
    offset: Tensor
    radius: Tensor

    def twice(self) -> "DotLayout":
        """For two presses of each gel."""
        return DotLayout(*(torch.cat([value, value]) for value in (self.pitch, self.offset, self.radius)))


def appearance(draws: Draws, n: int, u: Tensor, v: Tensor) -> BatchAppearance:
    """Sensors about the two training units: exposure, white balance, falloff, colour mixing and response all vary."""
    free = torch.stack([torch.tensor(SENSORS[name].free_gel.tolist()) for name in TRAINING_UNITS])
    answer = torch.stack([torch.tensor(SENSORS[name].slope_response.tolist()) for name in TRAINING_UNITS])
    free, answer = free.to(draws.device), answer.to(draws.device)
    share = draws.uniform(0, 1, n)[:, None, None]
    level = draws.normal(0.15, n, 1) + draws.normal(0.07, n, 3)
    table = share * free[0] + (1 - share) * free[1] + draws.normal(0.05, n, 3, 15)
    table[:, :, 0] = table[:, :, 0] + level
    gain = torch.exp(level + draws.normal(0.12, n, 1) + draws.normal(0.08, n, 3))[:, :, None]
    answers = (share * answer[0] + (1 - share) * answer[1]) * (1 + draws.normal(0.1, n, 3, 15))
    answers = (answers + draws.normal(4.0, n, 3, 15)) * gain
    # Filters leak: up to a quarter of each channel comes from the others.
    leak = draws.uniform(0, 0.25, n)[:, None, None]
    mixing = (1 - leak) * torch.eye(3, device=draws.device) + leak * draws.uniform(0, 0.6, n, 3, 3)
    return BatchAppearance(
        free=torch.einsum("ncd,ndhw->nchw", mixing, render.free_gel(table, u, v)),
        per_normal=torch.einsum("ncd,ndkhw->nckhw", mixing, render.per_normal(answers, u, v)),
        curvature=torch.einsum("ncd,ndk->nck", mixing, answers[:, :, 12:]),
    )


def gains(draws: Draws, n: int) -> Tensor:
    """How bright each colour of n presses is, (n, 3): the lamps drift."""
    large = 1 + 2.5 * draws.chance(0.15, n)[:, None]
    return torch.exp(large * (draws.normal(0.015, n, 1) + draws.normal(0.008, n, 3)))


def _white(draws: Draws, *shape: int) -> Tensor:
    return draws.normal(1.0, *shape)


def _maker_s_dots(draws: Draws, n: int) -> DotLayout:
    return DotLayout(
        torch.tensor([DOT_PITCH_MM] * n, device=draws.device),
        torch.zeros(n, 2, device=draws.device),
        torch.full((n,), DOT_RADIUS_MM, device=draws.device),
    )


@dataclass(frozen=True)
class RandomSensors:
    """How the sensors of a batch are drawn. A function that replaces one takes what it adds from `draws.apart`, so
    that nothing else of the batch changes.

    appearance: of n gels over the grid (u, v). gains: (n, 3), of n presses. noise: (n, 3, h, w), of unit variance.
    dots: of n tracking gels.
    """

    appearance: Callable[[Draws, int, Tensor, Tensor], BatchAppearance] = appearance
    gains: Callable[[Draws, int], Tensor] = gains
    noise: Callable[..., Tensor] = _white
    dots: Callable[[Draws, int], DotLayout] = _maker_s_dots


def under_dots(
    planes: Tensor, surface: Tensor, x: Tensor, y: Tensor, spacing: Spacing, layout: DotLayout
) -> Tensor:
    """The planes under tracking gels' dots, which spread away from where the gel bulges; a layout for each plane."""
    sx, sy = render.slopes(render.blur(surface, (0.6 / spacing[0], 0.6 / spacing[1])), spacing)
    (pitch_x, pitch_y), (offset_x, offset_y) = (
        values.T[:, :, None, None] for values in (layout.pitch, layout.offset)
    )
    # The simulator pushes along dz/dx; these slopes have the other sign.
    u, v = x - offset_x - DOT_SPREAD_MM * sx, y - offset_y - DOT_SPREAD_MM * sy
    u = u - pitch_x * (u / pitch_x).round()
    v = v - pitch_y * (v / pitch_y).round()
    apart = layout.radius[:, None, None] - torch.sqrt(u * u + v * v)
    covered = (apart / max(spacing) + 0.5).clamp(0, 1)
    return planes * (1 - (1 - DOT_KEEPS) * covered[:, None])
