"""The steps of SPADE in which a publication differs by a defect; `paper.py` has the published ones."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plugins.onnx_builder import Graph, Value

__all__ = ["CORRECTED", "LENGTH_FLOOR", "Steps", "keep_gallery", "relative_floor"]

# The seed scripts divide a descriptor by its length plus this.
LENGTH_FLOOR = 1e-6


@dataclass(frozen=True)
class Steps:
    """The steps in which a publication differs by a defect."""

    length_floor: Callable[[NDArray[np.floating]], float]
    """Layer (n, c, h, w) to the number added to a length before the division by it."""
    gallery: Callable[[NDArray[np.floating]], NDArray[np.floating]]
    """(presses, h, w, c) to the rows (m, c) that are searched where there is no window."""
    emit_gallery: Callable[[Graph, Value, tuple[int, int, int]], Value]
    """The same in a graph, of (m, presses * h * w, c) with (h, w, c)."""


def relative_floor(layer: NDArray[np.floating]) -> float:
    """Return a part of the mean length of a cell's descriptor, so that scaled features give the same map."""
    lengths = [np.sqrt(np.square(press, dtype=np.float64).sum(axis=0)).mean() for press in layer]
    return LENGTH_FLOOR * float(np.mean(lengths))


def keep_gallery(gallery: NDArray[np.floating]) -> NDArray[np.floating]:
    """Every cell."""
    return gallery.reshape(-1, gallery.shape[3])


CORRECTED = Steps(relative_floor, keep_gallery, lambda graph, bank, size: bank)
