"""A contact sheet: the worst and the best score maps, to see what is behind a metric."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.evaluate.scoring import Evaluation, ScoredPress
from edge.model.comparison import outline_regions
from edge.pictures.press_picture import PressCaption, draw_press

__all__ = ["draw_sheet"]

_COLUMNS = 4
_HEADING = 36
_PANEL = 384
_MASK_COLOUR, _PAPER, _INK = (255, 255, 255), 250, (25, 25, 25)

U8 = NDArray[np.uint8]


def draw_sheet(evaluation: Evaluation) -> bytes:
    """PNG bytes: four rows of up to four presses, each as a station shows it, with the mask's outline, and
    those of drawn regions."""
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
    drawn = [_draw(one, evaluation) for one in presses]
    drawn += [np.full_like(drawn[0], _PAPER)] * (_COLUMNS - len(drawn))
    row = np.concatenate(drawn, axis=1)
    heading = np.full((_HEADING, row.shape[1], 3), _PAPER, np.uint8)
    cv2.putText(heading, title, (8, 26), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _INK, 1, cv2.LINE_AA)
    return np.concatenate([heading, row])


def _draw(one: ScoredPress, evaluation: Evaluation) -> U8:
    manifest, rgb = evaluation.bundle.manifest, one.press.rgb()
    frame = np.ascontiguousarray(evaluation.bundle.region.crop(rgb))
    outlines, _ = cv2.findContours(one.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(frame, outlines, -1, _MASK_COLOUR, 1)
    caption = PressCaption(
        press_id=one.press.path.stem,
        verdict=manifest.decide(one.anomaly_score).kind,
        score=one.anomaly_score,
        threshold=evaluation.threshold,
        mm_per_pixel=evaluation.bundle.profile.mm_per_pixel,
        station=one.press.defect or "good",
        part=f"{one.press.part}/{one.press.position}",
        time="",
        drawn=manifest.regions.describe() if manifest.regions else "",
    )
    regions = outline_regions(evaluation.bundle, one.pose)
    return draw_press(frame, one.score_map, caption, _PANEL, outlines=regions)
