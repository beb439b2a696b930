"""Further losses for the ideas of `idea_ablation`: pairs of real frames, and a network learnt from photographs."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import onnxruntime as ort
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from calibration.training.jpeg import compressed
from calibration.training.losses import pair_losses
from calibration.training.random_sampling import Draws, draws_for
from calibration.training.random_sensors import appearance
from calibration.training.render import quantise, slopes
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import Pairs
from edge.core.imaging.known_profiles import MINI_LR_MM_PER_PX
from edge.model.onnx_prune import cut_trunk
from edge.model.session import open_session
from plugins.backbones.efficientnet_lite0 import efficientnet_lite0

__all__ = [
    "Distilled",
    "NextToPhotograph",
    "RealPairs",
    "of_photographs",
    "real_pairs",
    "together",
]

F32 = NDArray[np.float32]
Network = Callable[[Tensor], Tensor]
"""Frames (n, 3, h, w) to features (n, 24, h / 4, w / 4)."""

_SPACING = (MINI_LR_MM_PER_PX, MINI_LR_MM_PER_PX)
# Of the light between two pictures of one press: level and fall over the picture, as the development set relights.
_LIGHT, _FALL, _NOISE = 0.15, 0.08, 1.5
_ZOOM, _JPEG_QUALITY = (0.75, 1.33), (75.0, 96.0)
# Small edits: bumps and hollows, mm high and mm wide, of which a crop has some.
_EDITS, _EDIT_SHARE, _HIGH_MM, _WIDE_MM = 4, 0.6, (0.03, 0.12), (0.1, 0.35)
_LITE0_CHANNELS, _CHANNELS = 24, 64


class RealPairs(nn.Module):  # type: ignore[misc]
    """Crops of real presses twice under other light: equal places are pulled together, small edits pushed apart."""

    def __init__(self, pictures: Sequence[F32], recipe: TrainConfig, pairs: int = 4) -> None:
        super().__init__()
        self.pictures, self.recipe, self.pairs = pictures, recipe, pairs

    def forward(self, trunk: nn.Module, maps: list[Tensor], batch: Pairs, step: int) -> Tensor:
        real = real_pairs(self.pictures, self.recipe, step, self.pairs)
        return _weighed(trunk(real.frames)[0], real, self.recipe)


def real_pairs(pictures: Sequence[F32], recipe: TrainConfig, step: int, n: int) -> Pairs:
    """n crops of real presses, and the same under another light with small edits; the surface is not known."""
    draws = draws_for(recipe.seed, "real", step, torch.device("cpu"))
    side = recipe.side
    crops = torch.cat([_crop(pictures, draws, side) for _ in range(n)])
    relief = _bumps(draws, n, side)
    at = ((torch.arange(side) + 0.5) / side * 2 - 1).expand(side, side)
    gels = appearance(draws, n, at, at.T)
    nx, ny = slopes(relief, _SPACING)
    change = gels.per_normal[:, :, 0] * nx[:, None] + gels.per_normal[:, :, 1] * ny[:, None]
    frames = torch.cat([crops, crops + change])
    gain, across, down = (draws.uniform(-most, most, 2 * n, 3, 1, 1) for most in (_LIGHT, _FALL, _FALL))
    frames = frames * (1 + gain + across * at + down * at.T) + draws.normal(_NOISE, *frames.shape)
    quality = draws.uniform(*_JPEG_QUALITY, n)
    return Pairs(
        compressed(quantise(frames), torch.cat([quality, quality])),
        torch.zeros(2 * n, side, side),
        relief.abs(),
        _SPACING,
    )


def _crop(pictures: Sequence[F32], draws: Draws, side: int) -> Tensor:
    """A square of any picture at about its own scale, turned by quarters, (1, 3, side, side)."""
    number = int(draws.kind((1.0,) * len(pictures)))
    planes = torch.from_numpy(pictures[number]).permute(2, 0, 1)[None]
    size = round(side / float(draws.log_uniform(*_ZOOM)))
    top, left = (int(draws.uniform(0, 1) * (most - size)) for most in planes.shape[2:])
    cut = planes[:, :, top : top + size, left : left + size]
    cut = F.interpolate(cut, size=(side, side), mode="bilinear", align_corners=False)
    return cut.rot90(int(draws.kind((1.0,) * 4)), (2, 3))


def _bumps(draws: Draws, n: int, side: int) -> Tensor:
    """Height in mm that the edits add, (n, side, side)."""
    at = (torch.arange(side) + 0.5) * MINI_LR_MM_PER_PX
    x, y = draws.uniform(0, float(at[-1]), n, _EDITS), draws.uniform(0, float(at[-1]), n, _EDITS)
    high = draws.log_uniform(*_HIGH_MM, n, _EDITS) * (2 * draws.chance(0.5, n, _EDITS) - 1)
    high = high * draws.chance(_EDIT_SHARE, n, _EDITS)
    wide, long = draws.log_uniform(*_WIDE_MM, n, _EDITS), draws.log_uniform(*_WIDE_MM, n, _EDITS)
    along_x = torch.exp(-0.5 * ((at - x[:, :, None]) / wide[:, :, None]) ** 2)
    along_y = torch.exp(-0.5 * ((at - y[:, :, None]) / long[:, :, None]) ** 2)
    return torch.einsum("nky,nkx->nyx", along_y * high[:, :, None], along_x)


def _weighed(features: Tensor, batch: Pairs, recipe: TrainConfig) -> Tensor:
    pull, push, rank = pair_losses(features, batch, recipe)
    return recipe.pair_weight * (pull + push) + recipe.rank_weight * rank


@cache
def _lite0() -> ort.InferenceSession:
    return open_session(cut_trunk(efficientnet_lite0.trunk(), ("layer1",)), 1, "trunk")


def of_photographs(frames: Tensor) -> Tensor:
    """EfficientNet-Lite0's features at stride 4, (n, 24, h / 4, w / 4)."""
    pixels = frames.permute(0, 2, 3, 1).contiguous().byte().numpy()
    return torch.from_numpy(_lite0().run(["layer1"], {"frames": pixels})[0])


class NextToPhotograph(nn.Module):  # type: ignore[misc]
    """The pair and rank losses on the trunk's channels and EfficientNet-Lite0's together, which a joined trunk has."""

    def __init__(self, recipe: TrainConfig, ratio: float, network: Network = of_photographs) -> None:
        super().__init__()
        self.recipe, self.ratio, self.network = recipe, ratio, network

    def forward(self, trunk: nn.Module, maps: list[Tensor], batch: Pairs, step: int) -> Tensor:
        return _weighed(together(maps[0].float(), self.network(batch.frames), self.ratio), batch, self.recipe)


def together(felt: Tensor, photograph: Tensor, ratio: float) -> Tensor:
    """The channels of both, those of the photograph varying this many times as much as the tactile ones."""
    scale = _deviation(photograph) / (ratio * _deviation(felt.detach()))
    return torch.cat([felt * scale, photograph], dim=1)


def _deviation(features: Tensor) -> Tensor:
    """Over all channels."""
    return features.var(dim=(0, 2, 3)).sum().sqrt()


class Distilled(nn.Module):  # type: ignore[misc]
    """A 1x1 convolution reads EfficientNet-Lite0's features, of unit deviation, from the trunk's."""

    def __init__(self, network: Network = of_photographs) -> None:
        super().__init__()
        self.network = network
        self.reading = nn.Conv2d(_CHANNELS, _LITE0_CHANNELS, 1)

    def forward(self, trunk: nn.Module, maps: list[Tensor], batch: Pairs, step: int) -> Tensor:
        wanted = self.network(batch.frames)
        wanted = (wanted - wanted.mean(dim=(0, 2, 3), keepdim=True)) / (
            wanted.std(dim=(0, 2, 3), keepdim=True) + 1e-6
        )
        return F.smooth_l1_loss(self.reading(maps[0].float()), wanted)
