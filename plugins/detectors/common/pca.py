"""Fewer dimensions that still show what is outside them: leading principal directions and one remainder.

Rows of the basis are orthonormal, so a distance over the first d coordinates never exceeds the true one. Those alone
would hide an anomaly that points away from everything nominal. So one more coordinate is kept: the length of the part
outside the basis. By the triangle inequality the distance in these d+1 numbers also never exceeds the true distance,
and equals it where the parts outside are parallel.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from plugins.detectors.common.lowrank import spectrum
from plugins.onnx_builder import Graph, Value

__all__ = ["Rotation", "emit_rotation", "fit_rotation"]


@dataclass(frozen=True)
class Rotation:
    """Leading directions of descriptors, and their mean."""

    mean: F32
    """The mean, (c,)."""
    basis: F32 | None
    """Orthonormal rows, (d, c) (zero rows where the samples span less), None for all c."""

    @property
    def width(self) -> int:
        """Numbers per projected descriptor."""
        return len(self.mean) if self.basis is None else len(self.basis) + 1

    def __call__(
        self, rows: NDArray[np.floating], dtype: type[np.floating] = np.float64
    ) -> NDArray[np.floating]:
        """Descriptors (..., c) to (..., width)."""
        centred: NDArray[np.floating] = rows.astype(dtype) - self.mean.astype(dtype)
        if self.basis is None:
            return centred
        basis = self.basis.astype(dtype)
        along = centred @ basis.T
        rest = centred - along @ basis
        length = np.sqrt(np.einsum("...c,...c->...", rest, rest))
        return np.concatenate([along, length[..., None]], axis=-1)


def fit_rotation(rows: NDArray[np.floating], dims: int | None) -> Rotation:
    """Mean and leading `dims` directions of descriptors (m, c); dims None or at least c: all of them, unrotated."""
    mean = rows.mean(axis=0, dtype=np.float64).astype(np.float32)
    width = rows.shape[1]
    if dims is None or dims >= width:
        return Rotation(mean, None)
    directions = spectrum(rows, dims).basis
    basis = np.zeros((dims, width), np.float32)
    basis[: len(directions)] = directions
    return Rotation(mean, basis)


def emit_rotation(graph: Graph, columns: Value, mean: Value, basis: Value | None) -> Value:
    """Rotate in a graph: descriptors as columns (n, c, p), mean (c,), basis (d, c); gives rows (n, p, width)."""
    centred = graph.op("Sub", columns, graph.unsqueeze(mean, 1))
    if basis is not None:
        along = graph.op("MatMul", basis, centred)
        rest = graph.op("Sub", centred, graph.op("MatMul", graph.transpose(basis, 1, 0), along))
        # A product with ones instead of a sum over rows: four times faster in onnxruntime.
        shape = graph.op("Concat", graph.ints(1), graph.op("Shape", mean), axis=0)
        ones = graph.op("Expand", graph.scalar(1.0), shape)
        length = graph.op("Sqrt", graph.op("MatMul", ones, graph.op("Mul", rest, rest)))
        centred = graph.op("Concat", along, length, axis=1)
    return graph.transpose(centred, 0, 2, 1)
