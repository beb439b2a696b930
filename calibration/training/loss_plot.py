"""The loss figure, drawn with OpenCV, so that training needs no plotting library."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["draw_losses"]

_WIDTH, _HEIGHT, _MARGIN = 900, 420, 56
# RGB, distinct for colour-blind readers (Okabe and Ito).
_COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233))


def draw_losses(log: Sequence[dict[str, Any]], names: Sequence[str]) -> bytes:
    """PNG bytes: each named series over steps, on a logarithmic scale of its own largest and smallest values."""
    canvas = np.full((_HEIGHT, _WIDTH, 3), 255, np.uint8)
    series = {
        name: [(e["step"], e[name]) for e in log if e.get(name) is not None and e[name] > 0] for name in names
    }
    points = [value for values in series.values() for _, value in values]
    if points:
        low, high = np.log10(min(points)), np.log10(max(points))
        last = max(step for values in series.values() for step, _ in values)
        _axes(canvas, low, high, last)
        for colour, values in zip(_COLOURS, series.values(), strict=False):
            _curve(canvas, values, (low, high), last, colour)
        for row, (colour, name) in enumerate(zip(_COLOURS, series, strict=False)):
            cv2.putText(
                canvas,
                name,
                (_WIDTH - 150, 24 + 20 * row),
                cv2.FONT_HERSHEY_SIMPLEX,
                0.5,
                colour,
                1,
                cv2.LINE_AA,
            )
    return bytes(cv2.imencode(".png", cv2.cvtColor(canvas, cv2.COLOR_RGB2BGR))[1])


def _axes(canvas: NDArray[np.uint8], low: float, high: float, last: int) -> None:
    ink = (90, 90, 90)
    bottom = _HEIGHT - _MARGIN
    cv2.rectangle(canvas, (_MARGIN, 12), (_WIDTH - 12, bottom), ink, 1)
    for share in (0.0, 0.5, 1.0):
        x, y = int(_MARGIN + share * (_WIDTH - 12 - _MARGIN)), int(bottom - share * (bottom - 12))
        level = 10 ** (low + share * (high - low))
        cv2.putText(
            canvas, f"{int(share * last)}", (x - 24, bottom + 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, ink, 1
        )
        cv2.putText(canvas, f"{level:.3g}", (4, y + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, 1)
    cv2.putText(canvas, "step", (_WIDTH // 2, _HEIGHT - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, 1)


def _curve(
    canvas: NDArray[np.uint8],
    values: Sequence[tuple[int, float]],
    span: tuple[float, float],
    last: int,
    colour: tuple[int, int, int],
) -> None:
    if len(values) < 2:
        return
    steps, losses = np.array(values, np.float64).T
    x = _MARGIN + steps / max(last, 1) * (_WIDTH - 12 - _MARGIN)
    share = (np.log10(losses) - span[0]) / max(span[1] - span[0], 1e-9)
    y = _HEIGHT - _MARGIN - share * (_HEIGHT - _MARGIN - 12)
    line = np.stack([x, y], axis=1).astype(np.int32)
    cv2.polylines(canvas, [line], False, colour, 1, cv2.LINE_AA)
