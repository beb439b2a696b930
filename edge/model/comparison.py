"""A press beside the nominal press that it was compared with, and the drawn regions on it, as people see them."""

import numpy as np
from numpy.typing import NDArray

from edge.core.registration.pose import Pose, Registered, warp
from edge.model.bundle import Bundle
from edge.pictures.nominal_pictures import Compared
from edge.pictures.press_picture import Outline

__all__ = ["compare_press", "outline_regions"]

# Where no press of the bank's pose reaches, in the picture of the nominal press.
_NOTHING = 235.0


def compare_press(
    bundle: Bundle, rgb: NDArray[np.uint8], score_map: NDArray[np.floating], registered: Registered | None
) -> Compared | None:
    """Compare a press at its highest score; as it lies. None for a bundle without pictures of nominal presses.

    rgb, score_map: (h, w, 3) and (h, w) of the region.
    """
    pictures, scale = bundle.nominal_pictures, bundle.profile.mm_per_pixel
    if pictures is None:
        return None
    row, column = divmod(int(score_map.argmax()), score_map.shape[1])
    if registered is None:
        return pictures.compare(bundle.prepare(rgb), (column, row), scale)
    back, (h, w) = registered.pose.inverse(), score_map.shape
    x, y = back.matrix((w, h)) @ np.array([column, row, 1.0])
    comparison = pictures.compare(registered.rgb, (float(x), float(y)), scale)
    reached = warp(np.ones((h, w), np.float32), back)[..., None] > 0.5
    nominal = np.where(reached, warp(comparison.nominal, back), np.float32(_NOTHING))
    return Compared(nominal, warp(comparison.difference, back), comparison.name)


def outline_regions(bundle: Bundle, pose: Pose | None) -> list[Outline]:
    """Return the outlines of the drawn regions where the part lies in a press."""
    regions = bundle.manifest.regions.regions if bundle.manifest.regions else ()
    scale, frame = bundle.profile.mm_per_pixel, bundle.manifest.frame
    region_corners = ((region, region.corners_in_press(scale, frame, pose)) for region in regions)
    return [Outline(one.name, one.kind, corners) for one, corners in region_corners]
