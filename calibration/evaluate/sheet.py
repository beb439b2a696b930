"""A contact sheet: the worst and the best score maps, to see what is behind a metric."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.evaluate.scoring import Evaluation, ScoredPress
from edge.pictures.heatmap import FULL_SCALE, draw_contour, paint_scores, relative_scores

__all__ = ["draw_sheet"]

_COLUMNS = 4
_TILE = 224
_CAPTION = 22
_HEADING = 28
_LEGEND = 52
# Length of the scale bar, in millimetres across the sensor.
MM_BAR = 2.0
_MASK_COLOUR = (255, 255, 255)
_INK = (30, 30, 30)

U8 = NDArray[np.uint8]


def draw_sheet(evaluation: Evaluation) -> bytes:
    """PNG bytes: four rows of up to four presses, each as frame with the mask's outline, next to its score map.

    All maps have the colours of a station's pictures: from 0 to twice the threshold, which is the middle colour and
    the contour. The last line of the sheet is the legend.
    """
    good = sorted((s for s in evaluation.scored if not s.press.is_defective), key=lambda s: -s.anomaly_score)
    bad = sorted((s for s in evaluation.scored if s.press.is_defective), key=lambda s: s.anomaly_score)
    rows = (
        ("worst: good presses with the highest scores", good[:_COLUMNS]),
        ("worst: defective presses with the lowest scores", bad[:_COLUMNS]),
        ("best: defective presses with the highest scores", bad[::-1][:_COLUMNS]),
        ("best: good presses with the lowest scores", good[::-1][:_COLUMNS]),
    )
    drawn = [_row(title, presses, evaluation) for title, presses in rows if presses]
    sheet = np.concatenate([*drawn, _legend(evaluation)])
    return bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1])


def _row(title: str, presses: Sequence[ScoredPress], evaluation: Evaluation) -> U8:
    region = evaluation.bundle.region
    row = np.full((_HEADING + _TILE + _CAPTION, _COLUMNS * 2 * _TILE, 3), 245, np.uint8)
    _write(row, title, 8, _HEADING - 9, 0.6)
    for column, one in enumerate(presses):
        left = column * 2 * _TILE
        frame = _outlined(np.ascontiguousarray(region.crop(one.press.rgb())), one.mask)
        row[_HEADING : _HEADING + _TILE, left : left + _TILE] = _fit(frame)
        row[_HEADING : _HEADING + _TILE, left + _TILE : left + 2 * _TILE] = _fit(_heat(one, evaluation))
        ratio = f"{one.anomaly_score:.3g}, threshold {evaluation.threshold:.3g}  {one.press.path.stem}"
        _write(row, ratio, left + 6, _HEADING + _TILE + _CAPTION - 7, 0.42)
    return row


def _legend(evaluation: Evaluation) -> U8:
    """The colour bar from 0 to FULL_SCALE thresholds, and the length of a millimetre-wide bar under the tiles."""
    strip = np.full((_LEGEND, _COLUMNS * 2 * _TILE, 3), 245, np.uint8)
    ramp = np.linspace(0.0, FULL_SCALE, 2 * _TILE, dtype=np.float32)
    strip[8:24, 8 : 8 + 2 * _TILE] = paint_scores(np.repeat(ramp[None], 16, axis=0))
    for value in (0.0, 0.5, 1.0, 1.5, FULL_SCALE):
        x = 8 + round(value / FULL_SCALE * (2 * _TILE - 1))
        strip[8:28, x - 1 : x + 1] = _INK
        _write(strip, f"{value:g}", x - 4, 42, 0.42)
    _write(strip, "score / threshold; the white line is the threshold", 8 + 2 * _TILE + 20, 21, 0.5)
    profile = evaluation.bundle.profile
    pixels = round(MM_BAR / profile.mm_per_pixel[0] * _TILE / evaluation.bundle.region.width)
    left = 8 + 5 * _TILE
    strip[14:18, left : left + pixels] = _INK
    _write(strip, f"{MM_BAR:g} mm across", left + pixels + 8, 21, 0.5)
    return strip


def _fit(picture: U8) -> U8:
    return np.asarray(cv2.resize(picture, (_TILE, _TILE), interpolation=cv2.INTER_AREA), np.uint8)


def _outlined(frame: U8, mask: NDArray[np.bool_]) -> U8:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(frame.copy(), outlines, -1, _MASK_COLOUR, 1), np.uint8)


def _heat(one: ScoredPress, evaluation: Evaluation) -> U8:
    """The colours of the published pictures; a threshold that is not positive is replaced by half the map's maximum."""
    limit = evaluation.threshold if evaluation.threshold > 0 else max(float(one.score_map.max()) / 2, 1e-9)
    relative = relative_scores(one.score_map, limit)
    colours = paint_scores(relative)
    draw_contour(colours, relative)
    return colours


def _write(picture: U8, text: str, x: int, y: int, scale: float) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)
