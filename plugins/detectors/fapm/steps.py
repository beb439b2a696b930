"""The steps of FAPM in which the release differs by a defect; `paper.py` has the published ones."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plugins.detectors.fapm.weighting import emit_minus_largest, minus_largest
from plugins.onnx_builder import Graph, Value

__all__ = ["COARSE_SIDE", "CORRECTED", "FINE_SIDE", "Steps", "quadrant"]

# Sub-patches along one side of a cell, fine and coarse: FAPM_official test.py.
FINE_SIDE, COARSE_SIDE = 4, 2

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class Steps:
    """The steps in which a publication differs by a defect."""

    above: Callable[[Cells, Cells], tuple[Cells, Cells]]
    """Row and column of fine sub-patches to those of the coarse one whose distance is added."""
    shift: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    emit_shift: Callable[[Graph, Value], Value]
    """Subtracted from distances (n, k) before exp."""
    least_weighted: int
    """With fewer neighbours a score has no weight."""


def quadrant(row: Cells, column: Cells) -> tuple[Cells, Cells]:
    """The coarse sub-patch that covers the fine one."""
    return row // 2, column // 2


CORRECTED = Steps(quadrant, minus_largest, emit_minus_largest, least_weighted=2)
