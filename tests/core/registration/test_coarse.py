"""The coarse search: its candidates."""

import numpy as np
import pytest
import turned_parts as parts

from edge.core.registration.coarse import GRID, CoarseSearch
from edge.core.registration.pose import Pose


def test_no_candidate_lies_next_to_another() -> None:
    """A regular part fits nearly as well a pitch further on: each of the six best is a pose of its own."""
    slopes = parts.slopes(parts.TEETH, Pose(), GRID).astype(np.float32)
    found = CoarseSearch(slopes, 36).candidates(slopes, 6)
    places = [(one.pose.x_px, one.pose.y_px, round(one.pose.turn_rad * 18 / np.pi)) for one in found]

    assert all(
        max(abs(a - b) for a, b in zip(one, other, strict=True)) > 2
        for k, one in enumerate(places)
        for other in places[:k]
    )
    assert (found[0].pose, round(found[0].match, 3)) == (Pose(), 1.0)


def test_a_field_of_more_cells_than_the_grid_is_refused() -> None:
    """Found and expected are named."""
    with pytest.raises(ValueError, match="at most 64 cells a side, found"):
        CoarseSearch(np.zeros((65, 10, 2), np.float32), 4)
