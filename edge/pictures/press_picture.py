"""The picture of one press for people: the press on the left, its scores in colour on the right.

The press is not covered: only the contour of the threshold is drawn on it, around a defect. Below stand what it was
compared with, and the difference, where that is given. Verdict, score, scale in mm and the names of the press are
written around the panels. Texts in the file hold the same facts, so that a saved picture is complete. For programs
`encode_scores` writes the scores alone.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, U8
from edge.core.drawn_regions import RegionKind
from edge.core.printable import score_texts
from edge.pictures.heatmap import FULL_SCALE, draw_contour, paint_scores, relative_scores, score_at
from edge.pictures.image_file import PictureForm, encode, encode_jpeg
from edge.pictures.nominal_pictures import Compared

__all__ = [
    "CELL",
    "LARGEST_BYTES",
    "SCALE_KEYWORDS",
    "TEXT_KEYWORDS",
    "Outline",
    "PressCaption",
    "draw_press",
    "encode_press",
    "encode_scores",
]

# The longest side of one panel in pixels. Small regions are enlarged by a whole number, large ones shrunk.
_SMALLEST_PANEL: Final = 384
_LARGEST_PANEL: Final = 800

LARGEST_BYTES: Final = 2 << 20
"""Of a picture as a file: brokers, which limit messages to a few MB, keep it. Larger ones are drawn smaller."""

_HEADER: Final = 40
_FOOTER: Final = 28
_GAP: Final = 8
_LEGEND: Final = 112
_LINE: Final = 24  # of words below panels
_BAR: Final = 18

_REGION_COLOURS: Final = {"ignore": (140, 200, 255), "judge": (150, 235, 130), "stricter": (255, 190, 60)}

_PAPER: Final = 250  # of each colour; one number is filled in a hundredth of the time of three
_INK: Final = (25, 25, 25)
_VERDICT_COLOURS: Final = {"pass": (20, 120, 50), "fail": (185, 25, 30), "unsure": (175, 105, 0)}

# Levels of difference are drawn so many times as strong, about grey.
_TIMES: Final = 2
_GREY: Final = 128

# Possible lengths of a scale bar; the longest that fits into a third of the panel is drawn.
_BAR_LENGTHS_MM: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Outline(NamedTuple):
    """A drawn region where it lies in the press."""

    name: str
    kind: RegionKind
    corners: F64
    """(n, 2) in pixels of the inspected region, from its corner."""


class PressCaption(NamedTuple):
    """The text on a picture, and in its file."""

    press_id: str
    verdict: str
    score: float
    threshold: float
    mm_per_pixel: tuple[float, float]
    """(x, y) of the inspected region, not of the enlarged panel."""
    station: str
    """Site/line/station."""
    part: str
    time: str
    drawn: str = ""
    """What drawn regions ignore; empty without any."""

    deviation: str = ""
    """Depth and size of the deviation with the highest score, mm; empty where they are not known."""

    def texts(self) -> dict[str, str]:
        """Keyword to text, as in the file."""
        x, y = self.mm_per_pixel
        numbers = {
            "score": f"{self.score:.9g}",
            "threshold": f"{self.threshold:.9g}",
            "mm_per_pixel": f"{x:.6g} {y:.6g}",
        }
        texts = {keyword: numbers.get(keyword) or str(value) for keyword, value in self._asdict().items()}
        return {keyword: text for keyword, text in texts.items() if text or keyword not in _OPTIONAL}


_OPTIONAL: Final = {"drawn", "deviation"}
TEXT_KEYWORDS: Final = PressCaption._fields


def encode_press(
    rgb: U8,
    score_map: NDArray[np.floating],
    caption: PressCaption,
    form: PictureForm = "jpeg",
    compared: Compared | None = None,
    outlines: Sequence[Outline] = (),
) -> bytes:
    """`draw_press` as a file of at most LARGEST_BYTES whose texts are the caption."""
    write, largest_panel = encode if form == "png" else encode_jpeg, _LARGEST_PANEL
    while True:
        picture = write(
            draw_press(rgb, score_map, caption, largest_panel, compared, outlines), caption.texts()
        )
        if len(picture) <= LARGEST_BYTES:
            return picture
        largest_panel //= 2


def draw_press(
    rgb: U8,
    score_map: NDArray[np.floating],
    caption: PressCaption,
    largest_panel: int = _LARGEST_PANEL,
    compared: Compared | None = None,
    outlines: Sequence[Outline] = (),
) -> U8:
    """uint8 (height, width, 3) RGB. rgb: uint8 (h, w, 3), the inspected region. score_map: raw, (h, w) of the same.
    largest_panel: the longest side of one panel in pixels. compared: what is drawn below, of the same region.
    outlines: drawn regions.

    Both panels have the same scale in x and y, also when the profile compresses one axis. Errors: ValueError for
    other shapes, a map that is not finite, a threshold that is not.
    """
    if rgb.dtype != np.uint8 or rgb.shape != (*score_map.shape, 3):
        raise ValueError(f"the picture must be uint8 {(*score_map.shape, 3)}, found {rgb.dtype} {rgb.shape}")
    relative = relative_scores(score_map, caption.threshold)
    width, height = _panel_size(rgb.shape[1], rgb.shape[0], caption.mm_per_pixel, largest_panel)
    relative = np.asarray(cv2.resize(relative, (width, height), interpolation=_how(rgb, width)), np.float32)
    press, heat = _press_panel(rgb, width, height), paint_scores(relative)
    for panel in (press, heat):
        _draw_outlines(panel, outlines, (width / rgb.shape[1], height / rgb.shape[0]))
        draw_contour(panel, relative)
    _draw_scale_bar(press, caption.mm_per_pixel[0] * rgb.shape[1] / width)
    more = 0 if compared is None else height + _LINE
    sheet = np.full((_HEADER + height + more + _FOOTER, 2 * width + _GAP + _LEGEND, 3), _PAPER, np.uint8)
    sheet[_HEADER : _HEADER + height, :width] = press
    sheet[_HEADER : _HEADER + height, width + _GAP : 2 * width + _GAP] = heat
    if compared is not None:
        _draw_compared(sheet[_HEADER + height : _HEADER + height + more], compared, relative)
    _draw_legend(sheet[_HEADER : _HEADER + height, 2 * width + 2 * _GAP :], caption.threshold)
    _draw_header(sheet, caption)
    texts = (caption.deviation, caption.part, caption.station, caption.time, caption.press_id, caption.drawn)
    foot = "   ".join(text for text in texts if text)
    _write(sheet, foot, 6, sheet.shape[0] - 9, 0.42)
    return sheet


def _panel_size(w: int, h: int, mm_per_pixel: tuple[float, float], largest: int) -> tuple[int, int]:
    """(width, height) of a panel in which x and y have one scale."""
    true_h = h * mm_per_pixel[1] / mm_per_pixel[0]
    longest = max(w, true_h)
    factor = float(max(1, -(-_SMALLEST_PANEL // round(longest))))
    if longest * factor > largest:
        factor = largest / longest
    return max(1, round(w * factor)), max(1, round(true_h * factor))


def _press_panel(rgb: U8, width: int, height: int) -> U8:
    """The press at that size. Integer factors repeat pixels: the file is a third smaller, and no detail is added."""
    if width % rgb.shape[1] == 0 and height % rgb.shape[0] == 0:
        return rgb.repeat(width // rgb.shape[1], axis=1).repeat(height // rgb.shape[0], axis=0)
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=_how(rgb, width)), np.uint8)


def _how(rgb: U8, width: int) -> int:
    return cv2.INTER_AREA if width < rgb.shape[1] else cv2.INTER_LINEAR


def _draw_header(sheet: U8, caption: PressCaption) -> None:
    colour = _VERDICT_COLOURS.get(caption.verdict, _INK)
    word = caption.verdict.upper()
    width = cv2.getTextSize(word, cv2.FONT_HERSHEY_DUPLEX, 0.75, 1)[0][0] + 20
    cv2.rectangle(sheet, (0, 0), (width, _HEADER - 5), colour, cv2.FILLED)
    cv2.putText(sheet, word, (10, 25), cv2.FONT_HERSHEY_DUPLEX, 0.75, (255, 255, 255), 1, cv2.LINE_AA)
    score, threshold = score_texts(caption.score, caption.threshold, form="g")
    text = f"score {score}, threshold {threshold}"
    if caption.threshold > 0:
        text = f"{score_texts(caption.score / caption.threshold, 1.0, 2)[0]} x threshold   ({text})"
    _write(sheet, text, width + 12, 24, 0.55)


def _draw_legend(area: U8, threshold: float) -> None:
    """The colour bar with the line of the threshold in its middle; numbers are score / threshold, or scores where the
    threshold is not above 0."""
    height = area.shape[0]
    top, bottom = 10, height - 10
    rise = np.linspace(FULL_SCALE, 0.0, bottom - top, dtype=np.float32)
    area[top:bottom, :_BAR] = paint_scores(np.repeat(rise[:, None], _BAR, axis=1))
    for value in (FULL_SCALE, 1.5, 0.5, 0.0):
        number = value if threshold > 0 else score_at(value, threshold)
        text = f"{number:.4g}{' or more' if value == FULL_SCALE else ''}"
        _write(area, text, _BAR + 6, _at(value, top, bottom) + 4, 0.42)
    middle = _at(1.0, top, bottom)
    cv2.rectangle(area, (0, middle - 2), (_BAR - 1, middle + 1), (0, 0, 0), cv2.FILLED)
    cv2.rectangle(area, (0, middle - 1), (_BAR - 1, middle), (255, 255, 255), cv2.FILLED)
    _write(area, "1 threshold" if threshold > 0 else "threshold", _BAR + 6, middle + 4, 0.42)
    _write(area, f"= {threshold:.4g}", _BAR + 6, middle + 20, 0.42)


def _at(value: float, top: int, bottom: int) -> int:
    return round(bottom - 1 - (bottom - 1 - top) * value / FULL_SCALE)


def _draw_compared(area: U8, compared: Compared, relative: F32) -> None:
    """Draw two panels, with the contour of the press, below a line that says what they are."""
    height, width = relative.shape
    nominal, difference = compared.nominal, _GREY + _TIMES * compared.difference
    for picture, x in ((nominal, 0), (difference, width + _GAP)):
        levels = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        panel = np.asarray(cv2.resize(levels, (width, height), interpolation=_how(levels, width)), np.uint8)
        draw_contour(panel, relative)
        area[_LINE:, x : x + width] = panel
    _write(area, compared.name, 6, _LINE - 8, 0.45)
    _write(area, f"the press minus it, {_TIMES} times; grey: the same", width + _GAP + 6, _LINE - 8, 0.45)


def _draw_outlines(panel: U8, outlines: Sequence[Outline], scale: tuple[float, float]) -> None:
    """Draw each region's outline in the colour of its kind, with its name; their inside is unchanged."""
    for outline in outlines:
        colour = _REGION_COLOURS[outline.kind]
        corners = np.rint(outline.corners * np.array(scale)).astype(np.int32)
        for ink, thickness in (((0, 0, 0), 3), (colour, 1)):
            cv2.polylines(panel, [corners], True, ink, thickness, cv2.LINE_AA)
            x, y = (int(value) for value in corners[corners.sum(axis=1).argmin()])
            name = outline.name.encode("ascii", "replace").decode()
            at = max(2, x + 4), max(12, y - 5)
            cv2.putText(panel, name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, thickness, cv2.LINE_AA)


def _draw_scale_bar(panel: U8, mm_per_pixel: float) -> None:
    width = panel.shape[1]
    fitting = [mm for mm in _BAR_LENGTHS_MM if mm / mm_per_pixel <= width / 3]
    if not fitting:
        return
    length_mm = fitting[-1]
    pixels = round(length_mm / mm_per_pixel)
    x, y = 10, panel.shape[0] - 12
    cv2.rectangle(panel, (x - 2, y - 4), (x + pixels + 1, y + 1), (0, 0, 0), cv2.FILLED)
    cv2.rectangle(panel, (x, y - 2), (x + pixels - 1, y - 1), (255, 255, 255), cv2.FILLED)
    for colour, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(
            panel,
            f"{length_mm:g} mm",
            (x, y - 9),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.45,
            colour,
            thickness,
            cv2.LINE_AA,
        )


def _write(picture: U8, text: str, x: int, y: int, scale: float) -> None:
    """OpenCV draws ASCII letters only; others become question marks on the picture. The text chunks keep them."""
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(picture, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)


CELL: Final = 4
"""Pixels along a side: the stride of the finest grid of the shipped trunks. Finer values would be interpolated."""

SCALE_KEYWORDS: Final = ("zero", "step", "cell_px")
"""The texts beside those of the caption."""

_STEPS: Final = np.iinfo(np.uint16).max


def encode_scores(score_map: NDArray[np.floating], caption: PressCaption) -> bytes:
    """Write raw scores (h, w) as PNG, uint16 (ceil(h / CELL), ceil(w / CELL)), with their scale as text. `mm_per_pixel`
    is that of a cell.

    A value v stands for the score `zero + step v`, within half a step: the largest in a cell of CELL x CELL pixels, so
    that no place above the threshold is lost. Errors: ValueError for a map that is not finite.
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
