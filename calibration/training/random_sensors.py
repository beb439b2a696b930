"""Random draws on a device: each batch depends only on the seed and the step."""

import hashlib
import math

import torch
from torch import Tensor

from calibration.simulator.constants import DOT_KEEPS, DOT_PITCH_MM, DOT_RADIUS_MM, DOT_SPREAD_MM
from calibration.simulator.sensor_appearance import SENSORS
from calibration.training import render
from calibration.training.render import BatchAppearance, Spacing

__all__ = ["TRAINING_UNITS", "Draws", "appearance", "draws_for", "gains", "under_dots"]


class Draws:
    """Draws of float32 tensors from one generator."""

    def __init__(self, seed: int, device: torch.device) -> None:
        self.device = device
        self._seed = seed
        self._generator = torch.Generator(device=device).manual_seed(seed)

    def apart(self, purpose: str) -> "Draws":
        """Draws of another stream, equal for an equal seed; this stream goes on as if they were not made."""
        return draws_for(self._seed, purpose, 0, self.device)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=self._generator, device=self.device)

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return torch.exp(self.uniform(math.log(low), math.log(high), *shape))

    def normal(self, sd: float, *shape: int) -> Tensor:
        return sd * torch.randn(shape, generator=self._generator, device=self.device)

    def chance(self, share: float, *shape: int) -> Tensor:
        """1 with this probability, else 0."""
        return (torch.rand(shape, generator=self._generator, device=self.device) < share).float()

    def kind(self, shares: tuple[float, ...], *shape: int) -> Tensor:
        """Draw one index per element, int64, with these shares."""
        edges = torch.tensor(shares, device=self.device).cumsum(0)
        point = torch.rand(shape, generator=self._generator, device=self.device) * edges[-1]
        return torch.searchsorted(edges, point, right=True).clamp(max=len(shares) - 1)

    def pick(self, weights: Tensor) -> Tensor:
        """Draw one column per row, int64 (rows,), by weight; weights: (rows, columns), no row all zero."""
        return torch.multinomial(weights, 1, generator=self._generator)[:, 0]


def draws_for(seed: int, purpose: str, step: int, device: torch.device) -> Draws:
    """The draws of one step of one purpose (`train`, `validate`, `calibrate`): streams never overlap."""
    digest = hashlib.sha256(f"{purpose}/{seed}/{step}".encode()).digest()
    return Draws(int.from_bytes(digest[:7], "big"), device)


# Training mixes and varies these two measured sensors; `unit_c` is reserved for evaluation.
TRAINING_UNITS = ("unit_a", "unit_b")


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
    """Draw how bright each colour of n presses is, (n, 3): the lamps drift."""
    large = 1 + 2.5 * draws.chance(0.15, n)[:, None]
    return torch.exp(large * (draws.normal(0.015, n, 1) + draws.normal(0.008, n, 3)))


def under_dots(planes: Tensor, surface: Tensor, x: Tensor, y: Tensor, spacing: Spacing) -> Tensor:
    """Give the planes under a tracking gel's dots, which spread away from where the gel bulges."""
    sx, sy = render.slopes(render.blur(surface, (0.6 / spacing[0], 0.6 / spacing[1])), spacing)
    # The simulator pushes along dz/dx; these slopes have the other sign.
    u, v = x - DOT_SPREAD_MM * sx, y - DOT_SPREAD_MM * sy
    u = u - DOT_PITCH_MM[0] * (u / DOT_PITCH_MM[0]).round()
    v = v - DOT_PITCH_MM[1] * (v / DOT_PITCH_MM[1]).round()
    covered = ((DOT_RADIUS_MM - torch.sqrt(u * u + v * v)) / max(spacing) + 0.5).clamp(0, 1)
    return planes * (1 - (1 - DOT_KEEPS) * covered[:, None])
