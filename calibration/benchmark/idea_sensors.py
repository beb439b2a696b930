"""Other random sensors for the ideas of `idea_ablation`; each changes one thing and leaves the other draws alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from calibration.benchmark.idea_inputs import LEVEL
from calibration.simulator.constants import DOT_PITCH_MM, DOT_RADIUS_MM
from calibration.training.prefetch import draw_step
from calibration.training.random_sampling import Draws
from calibration.training.random_sensors import DotLayout, RandomSensors, appearance, gains
from calibration.training.render import BatchAppearance, quantise
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import Pairs

__all__ = ["RealGels", "RealNoise", "differences_to_free_gel", "other_dots", "other_units", "wandering_gains"]

F32 = NDArray[np.float32]

# Between real units the response to a slope differs by a factor of up to 1.7 (docs/simulator.md).
_RESPONSE = (1.0, 1.7)
# Automatic exposure moves a real level by a fifth within a session, and each colour by less.
_WANDER, _COLOUR_WANDER = 0.2, 0.05
# Times the maker's pitch and radius.
_PITCH, _RADIUS = (0.6, 1.5), (0.5, 1.4)
# Of the frames; the others keep a simulated free gel.
_REAL_SHARE = 0.5
_GRAIN_PX, _MOST_SD = 2.0, 3.0


def other_units(draws: Draws, n: int, u: Tensor, v: Tensor) -> BatchAppearance:
    """Gels whose colours answer to a slope 1 to 1.7 times as strongly."""
    found = appearance(draws, n, u, v)
    times = draws.apart("units").log_uniform(*_RESPONSE, n)
    return replace(
        found,
        per_normal=found.per_normal * times[:, None, None, None, None],
        curvature=found.curvature * times[:, None, None],
    )


def wandering_gains(draws: Draws, n: int) -> Tensor:
    """An exposure that moves by up to a fifth between the two presses of a pair, on top of what the lamps drift."""
    usual, apart = gains(draws, n), draws.apart("exposure")
    wander = apart.uniform(-_WANDER, _WANDER, n, 1) + apart.uniform(-_COLOUR_WANDER, _COLOUR_WANDER, n, 3)
    return usual * torch.exp(wander)


def other_dots(draws: Draws, n: int) -> DotLayout:
    """Marker gels of any pitch, radius and offset about the maker's."""
    apart = draws.apart("dots")
    pitch = torch.tensor(DOT_PITCH_MM, device=draws.device) * apart.log_uniform(*_PITCH, n, 1)
    return DotLayout(
        pitch,
        pitch * apart.uniform(-0.5, 0.5, n, 2),
        DOT_RADIUS_MM * apart.log_uniform(*_RADIUS, n),
    )


def differences_to_free_gel(recipe: TrainConfig, step: int, device: torch.device) -> Pairs:
    """The batch of a step whose frames are differences to the light of their free gels."""
    gels: list[Tensor] = []

    def noted(draws: Draws, n: int, u: Tensor, v: Tensor) -> BatchAppearance:
        found = appearance(draws, n, u, v)
        gels.append(found.free)
        return found

    batch = draw_step(recipe, step, device, RandomSensors(appearance=noted))
    return replace(batch, frames=quantise(LEVEL + batch.frames - torch.cat(gels * 2)))


@dataclass(frozen=True)
class RealGels:
    """Half of the gels are real ones, so a frame is a real free gel and what the simulated press changes of it.

    pictures: (240, 320, 3) in grey levels. A gel is mirrored at random, and as bright as a simulated one would be.
    """

    pictures: Sequence[F32]

    def __call__(self, draws: Draws, n: int, u: Tensor, v: Tensor) -> BatchAppearance:
        found, apart = appearance(draws, n, u, v), draws.apart("gels")
        which = apart.kind((1.0,) * len(self.pictures), n)
        flip = 2 * apart.chance(0.5, n, 2) - 1
        at = torch.stack([u * flip[:, :1, None], v * flip[:, 1:, None]], dim=-1)
        gel = F.grid_sample(
            _planes(self.pictures, draws.device)[which], at, padding_mode="reflection", align_corners=False
        )
        level = torch.exp(apart.normal(0.15, n, 1) + apart.normal(0.07, n, 3))
        is_real = apart.chance(_REAL_SHARE, n)[:, None, None, None]
        free = torch.where(is_real > 0, gel * level[:, :, None, None], found.free)
        return replace(found, free=free)


@dataclass(frozen=True)
class RealNoise:
    """Noise with the grain of real pictures: pieces of what is finer than two pixels in them, of unit variance.

    pictures: (240, 320, 3) in grey levels, of gels without dots.
    """

    pictures: Sequence[F32]

    def __call__(self, draws: Draws, *shape: int) -> Tensor:
        draws.normal(1.0, *shape)
        n, _, h, w = shape
        fine, apart = _planes([_grain(rgb) for rgb in self.pictures], draws.device), draws.apart("noise")
        which = apart.kind((1.0,) * len(fine), n).tolist()
        tops, lefts = (
            (apart.uniform(0, 1, n) * (size - wanted + 1)).long().tolist()
            for size, wanted in zip(fine.shape[2:], (h, w), strict=True)
        )
        return torch.stack(
            [
                fine[k, :, top : top + h, left : left + w]
                for k, top, left in zip(which, tops, lefts, strict=True)
            ]
        )


def _planes(pictures: Sequence[F32], device: torch.device) -> Tensor:
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).to(device)


def _grain(rgb: F32) -> F32:
    fine = rgb - cv2.GaussianBlur(rgb, (0, 0), _GRAIN_PX)
    return np.asarray(np.clip(fine / fine.std(axis=(0, 1)), -_MOST_SD, _MOST_SD), np.float32)
