"""Random draws on a device: each batch depends only on the seed and the step."""

import hashlib
import math

import torch
from torch import Tensor

__all__ = ["Draws", "draws_for"]


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
        """One index per element, int64, with these shares."""
        edges = torch.tensor(shares, device=self.device).cumsum(0)
        point = torch.rand(shape, generator=self._generator, device=self.device) * edges[-1]
        return torch.searchsorted(edges, point, right=True).clamp(max=len(shares) - 1)

    def pick(self, weights: Tensor) -> Tensor:
        """One column per row, int64 (rows,), by weight; weights: (rows, columns), no row all zero."""
        return torch.multinomial(weights, 1, generator=self._generator)[:, 0]


def draws_for(seed: int, purpose: str, step: int, device: torch.device) -> Draws:
    """The draws of one step of one purpose (`train`, `validate`, `calibrate`): streams never overlap."""
    digest = hashlib.sha256(f"{purpose}/{seed}/{step}".encode()).digest()
    return Draws(int.from_bytes(digest[:7], "big"), device)
