"""The training objective, at each stage that is learnt.

geometry: a 1x1 head must read slopes, depth and gradient energy from the features of a cell.
pair: features of two presses of one part are equal where the imprint is the same, and at least a margin apart where
damage changed it. The partner cell is searched within a window, as a detector does, so a shift needs no blur.
rank: a changed cell must be more distant than the most distant hundredth of unchanged ones: what a detector at one per
cent false alarms needs.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from calibration.training.train_config import STAGES, TrainConfig
from calibration.training.training_pairs import Pairs, Spacing

__all__ = ["Losses", "cell_distances", "find_changed_cells", "losses", "separation", "window_cells"]

# Typical sizes of slope, depth in mm and energy, so that the targets are of order 1.
_SLOPE, _DEPTH, _ENERGY = 0.3, 0.2, 0.1
# Softness of the rank loss, in feature distance.
_RANK_SOFTNESS = 0.1
_FALSE_ALARMS = 0.01
# The largest search window, in cells to either side: fine pictures would need hundreds of places.
_MOST_REACH = 3


@dataclass(frozen=True)
class Losses:
    """Scalars, each the mean over stages."""

    geometry: Tensor
    pull: Tensor
    push: Tensor
    rank: Tensor

    def total(self, recipe: TrainConfig) -> Tensor:
        return (
            recipe.geometry_weight * self.geometry
            + recipe.pair_weight * (self.pull + self.push)
            + recipe.rank_weight * self.rank
        )


def losses(maps: list[Tensor], heads: nn.ModuleDict, batch: Pairs, recipe: TrainConfig) -> Losses:
    """The losses of one batch. maps: the trunk's output for `batch.frames`."""
    geometry = _geometry(batch)
    parts: list[Tensor] = []
    for stage, features in zip(STAGES, maps, strict=True):
        stride = batch.change_mm.shape[-1] // features.shape[-1]
        target = F.avg_pool2d(geometry, stride)
        wrong = F.smooth_l1_loss(heads[stage](features.float()), target)
        parts.append(torch.stack([wrong, *pair_losses(features, batch, recipe)]))
    weight = torch.tensor([recipe.finest_weight, 1.0, 1.0], device=parts[0].device)
    return Losses(*(weight @ torch.stack(parts) / weight.sum()))


def pair_losses(features: Tensor, batch: Pairs, recipe: TrainConfig) -> tuple[Tensor, Tensor, Tensor]:
    """pull, push and rank of one map, (2n, channels, rows, columns)."""
    stride = batch.change_mm.shape[-1] // features.shape[-1]
    reach = window_cells(recipe.window_mm, stride, batch.spacing)
    distance = cell_distances(features, reach)
    changed, unchanged = find_changed_cells(batch.change_mm, stride, recipe)
    pull = (distance**2 * unchanged).sum() / unchanged.sum().clamp(min=1)
    push = ((recipe.margin - distance).clamp(min=0) ** 2 * changed).sum() / changed.sum().clamp(min=1)
    return pull, push, _rank(distance, changed, unchanged)


def _geometry(batch: Pairs) -> Tensor:
    """Targets (2n, 4, h, w) of order 1; slopes are positive on the right and lower sides of a bulge."""
    across, down = batch.spacing
    sy, sx = (-each for each in torch.gradient(batch.surface_mm, spacing=(down, across), dim=(1, 2)))
    energy = sx * sx + sy * sy
    return torch.stack([sx / _SLOPE, sy / _SLOPE, batch.surface_mm / _DEPTH, energy / _ENERGY], dim=1)


def window_cells(window_mm: float, stride: int, spacing: Spacing) -> tuple[int, int]:
    """Cells up and down, and left and right, that a window of this half width holds."""
    x, y = (min(_MOST_REACH, round(window_mm / (stride * mm))) for mm in spacing)
    return y, x


def cell_distances(features: Tensor, reach: tuple[int, int] = (0, 0)) -> Tensor:
    """Measure the distance from each cell of the partner to the nearest cell of the nominal press, (n, rows, columns).

    Features are compared as they are, in units of their root mean square length over the batch. reach: the search
    window in rows and columns to either side of the cell, as in a detector; cells outside the map do not count.
    """
    features = features.float()
    features = features / (features.square().sum(dim=1).mean() + 1e-12).sqrt()
    first, second = features.permute(0, 2, 3, 1).chunk(2)
    down, across = reach
    rows, columns = second.shape[1:3]
    margins = (across, across, down, down)
    wide = F.pad(first, (0, 0, *margins))
    length = F.pad(first.square().sum(dim=-1), margins, value=1e6)
    window = torch.arange(columns)[:, None] + torch.arange(2 * across + 1)
    window = window.to(features.device).expand(*second.shape[:2], -1, -1)
    nearest = torch.full_like(second[..., 0], 1e6)
    # Every column of a row against every column of a neighbouring row: much faster than one shift at a time.
    for top in range(2 * down + 1):
        near = slice(top, top + rows)
        apart = length[:, near, None] - 2 * (second @ wide[:, near].mT)
        nearest = torch.minimum(nearest, apart.gather(-1, window).amin(dim=-1))
    return torch.sqrt((second.square().sum(dim=-1) + nearest).clamp(min=0) + 1e-6)


def find_changed_cells(change_mm: Tensor, stride: int, recipe: TrainConfig) -> tuple[Tensor, Tensor]:
    """Float masks (n, rows, columns): cells that damage changed, and cells that it did not change, neighbours
    included."""
    most = F.max_pool2d(change_mm[:, None], stride)
    around = F.max_pool2d(most, 3, stride=1, padding=1)
    return (most[:, 0] > recipe.changed_mm).float(), (around[:, 0] < recipe.unchanged_mm).float()


def _rank(distance: Tensor, changed: Tensor, unchanged: Tensor) -> Tensor:
    """Measure softly how much changed cells fall below the most distant hundredth of unchanged ones."""
    count = max(1, int(_FALSE_ALARMS * distance.numel()))
    bar = (distance * unchanged).flatten().topk(count).values.mean()
    short = F.softplus((bar + _RANK_SOFTNESS - distance) / _RANK_SOFTNESS) * _RANK_SOFTNESS
    return (short * changed).sum() / changed.sum().clamp(min=1)


def separation(distance: Tensor, changed: Tensor, unchanged: Tensor) -> float:
    """The share of changed cells above 99 % of the unchanged ones."""
    sound, broken = distance[unchanged > 0], distance[changed > 0]
    if not len(sound) or not len(broken):
        return float("nan")
    bar = sound.kthvalue(max(1, int((1 - _FALSE_ALARMS) * len(sound)))).values
    return float((broken > bar).float().mean())
