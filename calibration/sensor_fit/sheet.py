"""The picture of a calibration: real, simulated, and the difference, press by press."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sensor_fit.result import Judged

__all__ = ["calibration_sheet"]

U8 = NDArray[np.uint8]

_MAGNIFIED, _SHOWN, _TITLE_PX, _GAP_PX, _PAPER = 4, 8, 20, 4, 24


def calibration_sheet(judged: Sequence[Judged]) -> U8:
    """Draw at most eight presses, the best to the worst: real | simulated | difference x 4 about mid grey; RGB."""
    ranked = sorted(judged, key=lambda one: one.inside)
    shown = [ranked[k] for k in np.linspace(0, len(ranked) - 1, min(_SHOWN, len(ranked))).round().astype(int)]
    return np.vstack([_row(one) for one in shown])


def _row(one: Judged) -> U8:
    difference = 128 + _MAGNIFIED * (one.simulated - one.real)
    gap = np.full((one.real.shape[1], _GAP_PX, 3), _PAPER, np.uint8)
    planes = (one.real, one.simulated, difference)
    pictures = [np.clip(np.rint(each), 0, 255).transpose(1, 2, 0).astype(np.uint8) for each in planes]
    row = np.hstack([pictures[0], gap, pictures[1], gap, pictures[2]])
    title = np.full((_TITLE_PX, row.shape[1], 3), _PAPER, np.uint8)
    text = (
        f"{one.name}: real | simulated | difference x{_MAGNIFIED}; {one.inside:.1f} levels rms inside contact"
    )
    cv2.putText(title, text, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return np.vstack([title, row])
