"""A press: the places that it shows, and whether its score is that of a place."""

import numpy as np
import pytest

from edge.core.press import Press
from edge.core.verdict import decide


def scored(highest: float) -> Press:
    """Of score 3; its map is 1, but for two pixels."""
    score_map = np.ones((32, 32), np.float32)
    score_map[8, 8:10] = highest
    return Press(decide(3.0, 2.0), score_map=score_map)


@pytest.mark.parametrize(
    ("highest", "is_of_place"), [(3.0, True), (3.0001, True), (3.01, False), (2.5, False)]
)
def test_a_score_is_of_a_place_where_the_map_has_it(highest: float, is_of_place: bool) -> None:
    """Relief that is missing scores higher than any place; a tenth of a thousandth is rounding."""
    assert scored(highest).is_of_place is is_of_place
    assert scored(highest).find_places(2.0)[0].score == pytest.approx(highest)


def test_a_press_without_a_map_has_no_places() -> None:
    for press in (Press(decide(3.0, 2.0)), Press(error="no score")):
        assert not press.is_of_place
        assert press.find_places(2.0) == []
