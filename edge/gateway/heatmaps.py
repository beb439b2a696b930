"""The picture of one press, as it is published and as it is made again."""

import numpy as np
from numpy.typing import NDArray

from edge.core.press import Press
from edge.messaging.payload_base import iso_time
from edge.model.bundle import Bundle
from edge.pictures.press_picture import PressCaption, press_png
from edge.store.press_store import PressRecord

__all__ = ["heatmap_png"]


def heatmap_png(press: PressRecord, inspection: Press, bundle: Bundle, station: str) -> bytes | None:
    """None for a press without a score. station: site/line/station."""
    if inspection.rgb is None or inspection.score_map is None or press.score is None:
        return None
    caption = PressCaption(
        press_id=press.press_id,
        verdict=press.verdict,
        score=press.score,
        threshold=bundle.manifest.threshold.value,
        mm_per_pixel=bundle.profile.mm_per_pixel,
        station=station,
        part="/".join(word for word in (press.part, press.position) if word),
        time=iso_time(press.time_ns),
    )
    return press_png(_dimmed(inspection.rgb, inspection), inspection.score_map, caption)


def _dimmed(rgb: NDArray[np.uint8], inspection: Press) -> NDArray[np.uint8]:
    """The press with the places that were not judged at half their light."""
    registered, scars = inspection.registered, inspection.scars
    unseen = None if registered is None else registered.unseen_in_press
    masked = None if scars is None else scars.masked
    for unjudged in (unseen, masked):
        if unjudged is not None:
            rgb = np.where(unjudged[..., None], rgb // 2, rgb)
    return rgb
