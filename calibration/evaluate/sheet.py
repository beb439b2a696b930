"""A contact sheet: the worst and the best maps, so that a number can be looked in the face."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.evaluate.scoring import Evaluation, ScoredPress

__all__ = ["draw_sheet"]

_COLUMNS = 4
_TILE = 224
_CAPTION = 22
_HEADING = 28
_MASK_COLOUR = (255, 255, 255)
_INK = (30, 30, 30)

U8 = NDArray[np.uint8]


def draw_sheet(evaluation: Evaluation) -> bytes:
    """PNG bytes: four rows of up to four presses, each as frame with the mask's outline beside its score map.

    All maps share one colour scale, from 0 to twice the threshold, so that the middle colour is the threshold.
    """
    good = sorted((s for s in evaluation.scored if not s.press.is_defective), key=lambda s: -s.anomaly_score)
    bad = sorted((s for s in evaluation.scored if s.press.is_defective), key=lambda s: s.anomaly_score)
    rows = (
        ("worst: good presses with the highest scores", good[:_COLUMNS]),
        ("worst: defective presses with the lowest scores", bad[:_COLUMNS]),
        ("best: defective presses with the highest scores", bad[::-1][:_COLUMNS]),
        ("best: good presses with the lowest scores", good[::-1][:_COLUMNS]),
    )
    sheet = np.concatenate([_row(title, presses, evaluation) for title, presses in rows if presses])
    return bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1])


def _row(title: str, presses: Sequence[ScoredPress], evaluation: Evaluation) -> U8:
    region = evaluation.bundle.region
    row = np.full((_HEADING + _TILE + _CAPTION, _COLUMNS * 2 * _TILE, 3), 245, np.uint8)
    _write(row, title, 8, _HEADING - 9, 0.6)
    for column, one in enumerate(presses):
        left = column * 2 * _TILE
        frame = _outlined(np.ascontiguousarray(region.crop(one.press.rgb())), one.mask)
        row[_HEADING : _HEADING + _TILE, left : left + _TILE] = _fit(frame)
        colours = _coloured(one.score_map, evaluation.threshold)
        row[_HEADING : _HEADING + _TILE, left + _TILE : left + 2 * _TILE] = _fit(colours)
        ratio = f"{one.anomaly_score:.3g}, threshold {evaluation.threshold:.3g}  {one.press.path.stem}"
        _write(row, ratio, left + 6, _HEADING + _TILE + _CAPTION - 7, 0.42)
    return row


def _fit(picture: U8) -> U8:
    return np.asarray(cv2.resize(picture, (_TILE, _TILE), interpolation=cv2.INTER_AREA), np.uint8)


def _outlined(frame: U8, mask: NDArray[np.bool_]) -> U8:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(frame.copy(), outlines, -1, _MASK_COLOUR, 1), np.uint8)


def _coloured(score_map: NDArray[np.float32], threshold: float) -> U8:
    top = 2 * threshold if threshold > 0 else max(float(score_map.max()), 1e-9)
    levels = np.clip(score_map / np.float32(top), 0, 1) * np.float32(255)
    return np.asarray(
        cv2.cvtColor(cv2.applyColorMap(levels.astype(np.uint8), cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB),
        np.uint8,
    )


def _write(picture: U8, text: str, x: int, y: int, scale: float) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)
