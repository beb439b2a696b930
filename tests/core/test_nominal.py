"""The presses of a fit, and how much of them a bank may keep."""

import numpy as np
import pytest

from edge.core.detector import Nominal


@pytest.mark.parametrize(
    ("room", "most", "limit"), [(0.5, 10, 5), (0.5, 1, 1), (2.0, 10, 20), (0.5, None, None)]
)
def test_the_bank_of_a_fold_has_its_share_of_room(room: float, most: int | None, limit: int | None) -> None:
    """And never none: half of one row is one."""
    assert Nominal({"tap": np.zeros((3, 2, 2, 4), np.float32)}, room=room).limit(most) == limit


@pytest.mark.parametrize("room", [0.0, -1.0, float("nan")])
def test_no_room_is_refused(room: float) -> None:
    with pytest.raises(ValueError, match="positive factor"):
        Nominal({"tap": np.zeros((3, 2, 2, 4), np.float32)}, room=room)
