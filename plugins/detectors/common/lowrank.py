"""Covariances as thin eigenpairs: the only form of a covariance here.

With N samples in d dimensions and N <= d, a covariance has at most N-1 directions; every other eigenvalue of the
regularised covariance C + ridge*I is exactly the ridge. So for delta = x - mean

    delta^T (C + ridge I)^-1 delta = sum_j (u_j . delta)^2 / (lambda_j + ridge)  +  |delta - U U^T delta|^2 / ridge

exactly (Woodbury's identity), with d*rank numbers instead of d*d. The difference form |delta|^2 - |W^T delta|^2 is the
same in exact arithmetic and loses all digits in float32 when lambda is far above the ridge. So the residual is computed
explicitly everywhere.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64

__all__ = ["RELATIVE_CUT", "Spectrum", "covariance_spectrum", "mahalanobis_squared", "spectrum"]

# Eigenvalues below this part of the largest are rounding noise of float64 sums (centring makes one of them zero). Noise
# stays below 2e-15; a channel that deviates a million times more than the others leaves these at 1e-12.
RELATIVE_CUT = 1e-14
# From this size on a few leading eigenpairs come from subspace iteration (Halko, Martinsson, Tropp 2011): 152 presses
# in 3136 locations took 4.0 s by full decomposition and 1.2 s this way, on two cores. The error is a small rotation
# within nearly equal eigenvalues; the off-span term is exact for the span that was found. With one iteration less the
# scores of 40 real presses, 16 of 64 directions, changed by 0.03 % in the median, by 0.16 % at most.
DIRECT_SIZE = 48
OVERSAMPLING = 8
ITERATIONS = 3


class Spectrum(NamedTuple):
    """Mean and thin eigenpairs of a covariance, for one or many sets of samples."""

    mean: F64
    """The mean, (..., d)."""
    values: F64
    """Eigenvalues (..., r), falling, 0 where a set has fewer than r directions."""
    basis: F64
    """Orthonormal rows (..., r, d), 0 where the value is 0."""


def spectrum(samples: NDArray[np.floating], rank: int | None = None) -> Spectrum:
    """Mean and leading eigenpairs of the covariance of `samples` (..., n, d), through the smaller Gram matrix.

    rank: the most directions (None: all that exist, n-1 or d). One sample has no covariance: rank 0. Directions below
    `RELATIVE_CUT` of the largest are dropped, including the one that centring makes zero.
    """
    x = samples.astype(np.float64)
    n, d = x.shape[-2:]
    if not n or not d:
        raise ValueError(f"a covariance needs samples and dimensions, found {x.shape}")
    mean = x.mean(axis=-2)
    x -= mean[..., None, :]
    most = min(n - 1, d)
    keep = most if rank is None else min(rank, most)
    if keep == 0:
        return Spectrum(mean, np.zeros((*x.shape[:-2], 0)), np.zeros((*x.shape[:-2], 0, d)))
    x /= np.sqrt(n - 1)
    if n > d:
        return covariance_spectrum(mean, np.swapaxes(x, -1, -2) @ x, keep)
    values, vectors = _leading(x @ np.swapaxes(x, -1, -2), keep)
    return _cut(mean, values, np.swapaxes(vectors, -1, -2) @ x)


def covariance_spectrum(mean: F64, covariance: F64, rank: int) -> Spectrum:
    """Give the spectrum of known covariances (..., d, d). rank: the most directions, at least 1."""
    values, vectors = _leading(covariance, rank)
    return _cut(mean, values, np.swapaxes(vectors, -1, -2).copy())


def _cut(mean: F64, values: F64, directions: F64) -> Spectrum:
    """Directions (..., r, d) as unit vectors; those of rounding noise become zero."""
    alive = values > RELATIVE_CUT * np.maximum(values[..., :1], np.finfo(np.float64).tiny)
    norms = np.linalg.norm(directions, axis=-1)
    basis = np.where(alive[..., None], directions / np.where(norms > 0, norms, 1.0)[..., None], 0.0)
    return Spectrum(mean, np.where(alive, values, 0.0), basis)


def _leading(gram: F64, keep: int) -> tuple[F64, F64]:
    """The `keep` largest eigenpairs of symmetric positive matrices, falling."""
    size = gram.shape[-1]
    block = keep + OVERSAMPLING
    if size <= DIRECT_SIZE or 2 * block > size:
        values, vectors = np.linalg.eigh(gram)
        return values[..., ::-1][..., :keep], vectors[..., ::-1][..., :keep]
    frame = gram[..., np.linspace(0, size - 1, block).astype(np.int64)]
    for _ in range(ITERATIONS):
        frame = gram @ np.linalg.qr(frame)[0]
    frame = np.linalg.qr(frame)[0]
    values, vectors = np.linalg.eigh(np.swapaxes(frame, -1, -2) @ gram @ frame)
    return values[..., ::-1][..., :keep], frame @ vectors[..., ::-1][..., :keep]


def mahalanobis_squared(delta: F64, values: F64, basis: F64, ridge: float) -> F64:
    """Squared distances (..., n) of `delta` (..., n, d) under eigenvalues (..., r), basis (..., r, d) and the ridge."""
    along = delta @ np.swapaxes(basis, -1, -2)
    off = delta - along @ basis
    inside: F64 = (along**2 / (values[..., None, :] + ridge)).sum(axis=-1)
    outside: F64 = (off**2).sum(axis=-1) / ridge
    return inside + outside
