"""The stored form of bank arrays: packed once at fit, unpacked to float32 once at load.

Dequantising inside the graph on every frame takes longer than the head itself (PaDiM, 28x28, rank 16: 1.9 ms against
0.3 ms on two cores). So the compact form is only on disk, and the runtime gets float32.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Packing

__all__ = ["Packed", "pack", "unpack"]

# A half holds 65504 at most and loses bits below 2**-14: the largest entry is scaled to just under 2**15.
HALF_TOP_EXPONENT = 15
INT8_TOP = 127
MAX_FLOAT32_EXPONENT = 126
LARGEST = 2.0**127
"""Rounding may raise a larger float32 to infinity."""


@dataclass(frozen=True)
class Packed:
    """An array as stored."""

    data: NDArray[Any]
    """The stored array."""
    scale: NDArray[np.float32] | None = None
    """float32, data's shape without its last axis, only for int8."""
    exponent: int = 0
    """float16 data are multiplied by 2**exponent when unpacked."""


def pack(array: NDArray[Any], packing: Packing) -> Packed:
    """The stored form of a float32 array; `none` keeps any dtype.

    Error of one entry x: float16 at most 2**-11 |x| + 2**-40 max|array|; int8 at most 0.501 of its row's scale,
    which is max|row| / 127, rounded up to a float32. Errors: ValueError for an entry that is not finite, or above
    LARGEST where it is rounded, and for a packing that the dtype cannot take.
    """
    array = np.ascontiguousarray(array)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError("it holds NaN or infinity")
    if packing == "none":
        return Packed(array)
    if array.dtype != np.float32 or array.ndim == 0:
        raise ValueError(
            f"{packing} packs float32 arrays with at least one axis, found {array.dtype} {array.shape}"
        )
    if (top := float(np.abs(array).max(initial=0.0))) > LARGEST:
        raise ValueError(f"it holds {top:.3g}; {packing} takes numbers up to {LARGEST:.3g}")
    return _pack_float16(array) if packing == "float16" else _pack_int8(array)


def _pack_float16(array: NDArray[np.float32]) -> Packed:
    top = float(np.abs(array).max(initial=0.0))
    exponent = math.frexp(top)[1] - HALF_TOP_EXPONENT if top > 0 else 0
    with np.errstate(under="ignore"):
        return Packed(_scale_by_power(array, -exponent).astype(np.float16), exponent=exponent)


def _scale_by_power(array: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return array * 2**times, exact except for subnormals.

    Where a float32 holds the factor, a product is ten times faster than ldexp.
    """
    if abs(times) <= MAX_FLOAT32_EXPONENT:
        return array * np.float32(2.0**times)
    return np.ldexp(array, times)


def _pack_int8(array: NDArray[np.float32]) -> Packed:
    top = np.abs(array).max(axis=-1, initial=0.0).astype(np.float64)
    with np.errstate(under="ignore"):
        scale = (top / INT8_TOP).astype(np.float32)
    # A scale rounded down would push the row's largest entry past 127.
    scale = np.where(
        scale.astype(np.float64) * INT8_TOP < top, np.nextafter(scale, np.float32(np.inf)), scale
    )
    # In float32: a quotient is at most 127, so its rounding moves an entry by 1e-5 of a step.
    steps = array / np.where(scale > 0, scale, np.float32(1)).astype(np.float32)[..., None]
    return Packed(np.rint(steps, out=steps).astype(np.int8), scale=np.asarray(scale, np.float32))


def unpack(packed: Packed, packing: Packing) -> NDArray[Any]:
    """The array for the head's input: the inverse of `pack` within its stated error."""
    if packing == "none":
        return packed.data
    with np.errstate(under="ignore"):
        if packing == "float16":
            return _scale_by_power(packed.data.astype(np.float32), packed.exponent)
        if packed.scale is None:
            raise ValueError("int8 data need their scale")
        return packed.data * packed.scale[..., None]
