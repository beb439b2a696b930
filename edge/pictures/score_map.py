"""The score map of one press for programs: one small PNG of 16 bits, with its scale as text.

Each value is the largest score in a cell of CELL x CELL pixels of the inspected region, so no place above the threshold
is lost. A value v stands for the score `zero + step v`, within half a step.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from edge.pictures.image_file import encode
from edge.pictures.press_picture import PressCaption

__all__ = ["CELL", "SCALE_KEYWORDS", "encode_scores"]

CELL: Final = 4
"""Pixels along a side: the stride of the finest grid of the shipped trunks. Finer values would be interpolated."""

SCALE_KEYWORDS: Final = ("zero", "step", "cell_px")
"""The texts beside those of the caption."""

_STEPS: Final = np.iinfo(np.uint16).max


def encode_scores(score_map: NDArray[np.floating], caption: PressCaption) -> bytes:
    """Write raw scores (h, w) as PNG, uint16 (ceil(h / CELL), ceil(w / CELL)). `mm_per_pixel` is that of a cell.

    Errors: ValueError for a map that is not finite.
    """
    if score_map.ndim != 2 or not np.isfinite(score_map).all():
        raise ValueError(f"a score map is finite and (h, w), found {score_map.shape}, some not finite")
    rows, columns = (np.arange(0, side, CELL) for side in score_map.shape)
    cells = np.maximum.reduceat(np.maximum.reduceat(score_map, rows, axis=0), columns, axis=1)
    zero = float(cells.min())
    step = (float(cells.max()) - zero) / _STEPS
    levels = (cells.astype(np.float64) - zero) / step if step > 0 else np.zeros(cells.shape)
    x, y = caption.mm_per_pixel
    scale = {"zero": f"{zero:.17g}", "step": f"{step:.17g}", "cell_px": str(CELL)}
    texts = {**caption._replace(mm_per_pixel=(x * CELL, y * CELL)).texts(), **scale}
    return encode(np.rint(levels).astype(np.uint16), texts)
