"""From means and dense covariances of any program to the parts of a PaDiM bundle, and what the reduction costs.

A covariance of N presses plus a ridge has at most N - 1 directions whose eigenvalue differs from the ridge; with those
kept, the Mahalanobis distance is the same (Woodbury). Directions that are left out count as ridge.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64
from edge.core.detector import Bank, Features, Grid
from edge.core.errors import ConfigError
from export.importers.contract import Settings
from export.importers.heads import MapSteps, padim_head
from plugins.detectors.common.embedding import Embedding, split_channels
from plugins.detectors.common.parameters import EmbeddingParameters
from plugins.reading.foreign import float32

__all__ = ["Gaussians", "Reduced", "padim_parts", "reduce_matrices"]

# A direction whose squared distance would change by less than this part counts as ridge: far below what a score shows.
CUT = 1e-3
# So does one that the file's own rounding moves away from the ridge: by at most the condition of the matrix times half
# a unit of its last digit, measured on anomalib's inverses of 550 x 550. The directions of presses are far above it.
ROUNDINGS = 4
# Matrices decomposed at once, so that memory stays bounded.
BLOCK = 64
# Cells on which the full form is compared with the reduced one.
COMPARED_CELLS = 256


@dataclass(frozen=True)
class Gaussians:
    """What a file holds of PaDiM."""

    path: Path
    name: str
    """The matrices' field."""
    layers: tuple[str, ...]
    """Taps in the order of the channels."""
    channels: NDArray[np.int64]
    """(d,), counted through all taps, in the file's order."""
    mean: NDArray[Any]
    """(cells, d)."""
    dense: Callable[[slice], NDArray[Any]]
    """Matrices (m, d, d) of a slice of cells, ridge included."""
    is_inverse: bool
    """Whether these are inverse covariances."""


@dataclass(frozen=True)
class Reduced:
    """basis (m, r, d) float32, weights (m, r) float32, both as in a PaDiM bank."""

    basis: F32
    weights: F32
    ridge: float
    rank: int
    """Directions that differ from the ridge, of the cell that has most."""
    loss: float
    """The largest relative change of a squared distance, in the worst direction."""

    def words(self) -> str:
        """The reduction in one sentence."""
        kept, d = self.basis.shape[1:]
        exact = "exact" if kept >= self.rank else f"{self.rank} would be exact"
        return (
            f"covariances {d} x {d} became {kept} directions ({exact}) over a ridge of {self.ridge:.5g}; a "
            f"squared distance changes by at most {100 * self.loss:.2g} % in the worst direction"
        )


def reduce_matrices(given: Gaussians, rank: int | None) -> Reduced:
    """Find the thin form of the matrices. Errors: ConfigError for matrices that are not covariances."""
    bottom, count = _ridge(given), len(given.mean)
    values, rows, needed, loss = [], [], 0, 0.0
    for start in range(0, count, BLOCK):
        spread, vectors = _spectrum(given, slice(start, min(start + BLOCK, count)))
        apart = np.abs(spread / bottom - 1)
        order = np.argsort(-np.abs(np.log(spread / bottom)), axis=1, kind="stable")
        apart = np.take_along_axis(apart, order, axis=1)
        most = int((apart > _cut(spread, bottom, given.dense(slice(0, 1)).dtype)).sum(axis=1).max())
        needed = max(needed, most)
        keep = max(1, most if rank is None else min(rank, most))
        loss = max(loss, float(apart[:, keep:].max(initial=0.0)))
        order = order[:, :keep]
        values.append(np.take_along_axis(spread, order, axis=1))
        rows.append(float32(np.take_along_axis(vectors, order[:, None, :], axis=2).swapaxes(1, 2)))
    return Reduced(_pad(rows), _pad_weights(values, bottom), bottom, needed, loss)


def _spectrum(given: Gaussians, part: slice) -> tuple[F64, F64]:
    """Eigenvalues (m, d) of the covariances with their ridge, and eigenvectors as columns. Errors: ConfigError."""
    matrices, where = np.asarray(given.dense(part), np.float64), f"{given.path}: '{given.name}' holds"
    if not np.isfinite(matrices).all():
        raise ConfigError(
            f"{where} values that are not finite; fit the model again with two pictures or more"
        )
    values, vectors = np.linalg.eigh((matrices + matrices.swapaxes(1, 2)) / 2)
    if not (values > 0).all():
        raise ConfigError(
            f"{where} a matrix with the eigenvalue {values.min():.3g}; covariances with a ridge have "
            "positive ones, fit the model again"
        )
    return (1 / values if given.is_inverse else values), vectors


def _cut(spread: F64, ridge: float, dtype: np.dtype[Any]) -> F64:
    """Limit how far from 1 an eigenvalue over the ridge may be and still count as ridge, (m, 1)."""
    condition = spread.max(axis=1, keepdims=True) / ridge
    digit = np.finfo(dtype if dtype.kind == "f" else np.float64).epsneg
    return np.asarray(np.maximum(CUT, ROUNDINGS * digit * condition), np.float64)


def _some(given: Gaussians, most: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Some cells, at most so many, and their matrices."""
    cells = np.unique(np.linspace(0, len(given.mean) - 1, most).astype(np.int64))
    return cells, np.concatenate([np.asarray(given.dense(slice(k, k + 1))) for k in cells])


def _ridge(given: Gaussians) -> float:
    """The middle of the eigenvalues that are as small as the smallest, over some cells."""
    _, stored = _some(given, min(len(given.mean), BLOCK))
    matrices = stored.astype(np.float64)
    values = np.maximum(np.linalg.eigvalsh(np.where(np.isfinite(matrices), matrices, 0)), 1e-12)
    spread = 1 / values if given.is_inverse else values
    least = spread.min(axis=1, keepdims=True)
    limits = least * (1 + _cut(spread, float(np.median(least)), stored.dtype))
    return float(np.nanmedian(np.where(spread <= limits, spread, np.nan)))


def _pad(rows: list[F32]) -> F32:
    """Blocks of different ranks as one array, with directions of zeros."""
    rank = max(block.shape[1] for block in rows)
    return np.concatenate([np.pad(block, ((0, 0), (0, rank - block.shape[1]), (0, 0))) for block in rows])


def _pad_weights(values: list[F64], ridge: float) -> F32:
    rank = max(block.shape[1] for block in values)
    padded = [np.pad(block, ((0, 0), (0, rank - block.shape[1])), constant_values=ridge) for block in values]
    return (1 / np.concatenate(padded)).astype(np.float32)


@dataclass(frozen=True)
class PadimParts:
    """The head, the bank, the reduction, and the comparison of both forms."""

    head: bytes
    bank: Bank
    reduction: Reduced
    exact: Callable[[Features], tuple[F64, F64]]

    @property
    def facts(self) -> dict[str, Any]:
        """The reduction, for the manifest."""
        thin = self.reduction
        return {"rank": thin.basis.shape[1], "ridge": thin.ridge, "loss": thin.loss}


def padim_parts(given: Gaussians, grid: Grid, steps: MapSteps, settings: Settings) -> PadimParts:
    """Make the parts of a PaDiM bundle. Errors: ConfigError for channels, cells or matrices that do not fit."""
    order = np.argsort(given.channels, kind="stable")
    file = given.dense

    def dense(part: slice) -> NDArray[Any]:
        return np.asarray(file(part))[:, order][:, :, order]

    given = replace(given, channels=given.channels[order], mean=float32(given.mean[:, order]), dense=dense)
    embedding = _embedding(given, grid)
    if len(given.mean) != embedding.count:
        raise ConfigError(
            f"{given.path}: 'mean' has {len(given.mean)} places, the taps give {embedding.count} on a picture of "
            f"{steps.framing.size} (h, w); give the picture size and trunk of the training"
        )
    thin = reduce_matrices(given, settings.rank)
    arrays = {**embedding.arrays, "mean": given.mean, "basis": thin.basis, "weights": thin.weights}
    head, bank = padim_head(embedding, thin.ridge, steps), settings.bank(arrays, "basis")
    return PadimParts(head, bank, thin, partial(_both, embedding, given, thin))


def _embedding(given: Gaussians, grid: Grid) -> Embedding:
    """Make the embedding that takes the channels, which rise."""
    total, chosen = sum(grid.taps[tap][0] for tap in given.layers), given.channels
    if chosen[0] < 0 or chosen[-1] >= total or len(np.unique(chosen)) != len(chosen):
        raise ConfigError(
            f"{given.path}: the selected channels go from {chosen[0]} to {chosen[-1]}, the taps "
            f"{', '.join(given.layers)} have {total}, each at most once; name the trunk and layers of the training"
        )
    choice = EmbeddingParameters(
        taps=given.layers,
        grid_tap=given.layers[0],
        projection="random",
        channels=len(chosen),
        is_balanced=False,
        is_sampled=False,
    )
    return Embedding(choice, grid, split_channels(chosen, given.layers, grid))


def _both(embedding: Embedding, given: Gaussians, thin: Reduced, features: Features) -> tuple[F64, F64]:
    """Distances (n, cells) of some cells by the file's matrices and by the bank."""
    cells, stored = _some(given, COMPARED_CELLS)
    delta, matrices = embedding.numpy(features).at(cells) - given.mean[cells, None], stored.astype(np.float64)
    applied = (
        delta @ matrices
        if given.is_inverse
        else np.linalg.solve(matrices, delta.swapaxes(1, 2)).swapaxes(1, 2)
    )
    full = np.sqrt(np.maximum((applied * delta).sum(axis=2), 0))
    basis, weights = thin.basis[cells].astype(np.float64), thin.weights[cells].astype(np.float64)
    along = delta @ basis.swapaxes(1, 2)
    off = delta - along @ basis
    short = np.sqrt((along**2 * weights[:, None]).sum(axis=2) + (off**2).sum(axis=2) / thin.ridge)
    return full.T, short.T
