"""From means and dense covariances of any program to the parts of a PaDiM bundle."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid
from edge.core.errors import ConfigError
from export.importers.contract import Settings
from export.importers.gaussians import Reduced, distances_both_ways, reduce_matrices
from export.importers.heads import MapSteps, padim_head
from plugins.detectors.common.embedding import Embedding, EmbeddingChoice
from plugins.reading.foreign import float32

__all__ = ["Gaussians", "PadimParts", "padim_parts"]

# Cells on which the full form is compared with the reduced one.
COMPARED_CELLS = 256


@dataclass(frozen=True)
class Gaussians:
    """What a file holds of PaDiM.

    layers: taps in the order of the channels. channels: (d,), counted through all taps, in the file's order. mean:
    (cells, d). dense: matrices (m, d, d) of a slice of cells. name: the matrices' field.
    """

    path: Path
    name: str
    layers: tuple[str, ...]
    channels: NDArray[np.int64]
    mean: NDArray[Any]
    dense: Callable[[slice], NDArray[Any]]
    is_inverse: bool
    ridge: float | None = None


@dataclass(frozen=True)
class PadimParts:
    """The head, the bank, the reduction, and the comparison of both forms."""

    head: bytes
    bank: Bank
    reduction: Reduced
    exact: Callable[[Features], tuple[NDArray[np.float64], NDArray[np.float64]]]

    @property
    def facts(self) -> dict[str, Any]:
        """The reduction, for the manifest."""
        thin = self.reduction
        return {"rank": thin.basis.shape[1], "ridge": thin.ridge, "loss": thin.loss}


def padim_parts(given: Gaussians, grid: Grid, steps: MapSteps, settings: Settings) -> PadimParts:
    """Make the parts of a PaDiM bundle. Errors: ConfigError for channels, cells or matrices that do not fit."""
    order, embedding = _embedding(given, grid)
    if given.mean.shape[0] != embedding.count:
        raise ConfigError(
            f"{given.path}: 'mean' has {given.mean.shape[0]} places, the taps give {embedding.count} on a picture of "
            f"{steps.framing.size} (h, w); give the picture size and trunk of the training"
        )

    def dense(part: slice) -> NDArray[Any]:
        return np.asarray(given.dense(part))[:, order][:, :, order]

    thin = reduce_matrices(
        dense, embedding.count, given.is_inverse, settings.rank, given.ridge, given.path, given.name
    )
    mean = float32(given.mean[:, order])
    arrays = {**embedding.arrays, "mean": mean, "basis": thin.basis, "weights": thin.weights}
    head, bank = padim_head(embedding, thin.ridge, steps), settings.bank(arrays, "basis")
    return PadimParts(head, bank, thin, partial(_both, embedding, dense, given.is_inverse, thin, mean))


def _embedding(given: Gaussians, grid: Grid) -> tuple[NDArray[np.int64], Embedding]:
    """The order that sorts the file's channels, and the embedding that takes them."""
    counts = [grid.taps[tap][0] for tap in given.layers]
    total = sum(counts)
    order = np.argsort(given.channels, kind="stable")
    chosen = given.channels[order]
    if chosen[0] < 0 or chosen[-1] >= total or len(np.unique(chosen)) != len(chosen):
        raise ConfigError(
            f"{given.path}: the selected channels go from {chosen[0]} to {chosen[-1]}, the taps "
            f"{', '.join(given.layers)} have {total}, each at most once; name the trunk and layers of the training"
        )
    arrays, first = {}, 0
    for tap, count in zip(given.layers, counts, strict=True):
        arrays[f"channels_{tap}"] = chosen[(chosen >= first) & (chosen < first + count)] - first
        first += count
    choice = EmbeddingChoice(
        given.layers,
        given.layers[0],
        "random",
        len(chosen),
        False,
        False,
        tuple(int(channel) for channel in chosen),
    )
    return order, Embedding(choice, grid, arrays)


def _both(
    embedding: Embedding,
    dense: Callable[[slice], NDArray[Any]],
    is_inverse: bool,
    thin: Reduced,
    mean: NDArray[np.float32],
    features: Features,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances (n, cells) of some cells by the file's matrices and by the bank."""
    cells = np.unique(np.linspace(0, embedding.count - 1, COMPARED_CELLS).astype(np.int64))
    delta = embedding.numpy(features).at(cells) - mean[cells, None]
    matrices = np.concatenate([np.asarray(dense(slice(k, k + 1)), np.float64) for k in cells])
    return distances_both_ways(delta, matrices, is_inverse, thin, cells)
