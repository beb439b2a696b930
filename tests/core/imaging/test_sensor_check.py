"""Coarse colours: what changes the distance, what does not, and the message of a rejection."""

import re
from contextlib import nullcontext

import numpy as np
import pytest

from edge.core.imaging.quality import Reason
from edge.core.imaging.sensor_check import (
    NominalColours,
    check_sensor,
    colour_cells,
    colour_distance,
    likely_cause,
)

CELLS = np.tile(np.array([150.0, 100.0, 50.0]), (8, 8, 1))
NOMINAL = NominalColours(CELLS, 0.14)


def picture(r: int, g: int, b: int) -> np.ndarray:
    return np.tile(np.array([r, g, b], np.uint8), (64, 64, 1))


def test_cells_are_mean_colours() -> None:
    """Worked by hand: a region whose left half is 10 and right half 30 has such cells, and 20 as one cell."""
    rgb = np.full((16, 16, 3), 10, np.uint8)
    rgb[:, 8:] = 30
    assert colour_cells(rgb, (2, 2)).tolist() == [[[10] * 3, [30] * 3]] * 2
    assert colour_cells(rgb, (1, 1)).tolist() == [[[20] * 3]]


@pytest.mark.parametrize("gain", [0.2, 0.7, 1.0, 1.6])
def test_a_common_gain_moves_nothing(gain: float) -> None:
    """With all lamps dimmer or brighter by one factor it is the same sensor."""
    assert colour_distance(gain * CELLS, CELLS) == pytest.approx(0, abs=1e-12)


def test_the_largest_channel_counts_by_the_light() -> None:
    """Worked by hand: red and blue exchanged leave the light at 100 and differ by 100."""
    assert colour_distance(CELLS[..., ::-1], CELLS) == pytest.approx(1.0)


@pytest.mark.parametrize(("rows", "is_near"), [(3, True), (5, False)])
def test_an_imprint_on_less_than_half_moves_nothing(rows: int, is_near: bool) -> None:
    """The median over cells: three rows of eight may have any colour, five may not."""
    cells = CELLS.copy()
    cells[:rows] = cells[:rows, :, ::-1]
    assert (colour_distance(cells, CELLS) < 0.01) == is_near


def test_black_is_far_and_finite() -> None:
    """No division by an absent light."""
    assert colour_distance(np.zeros((8, 8, 3)), CELLS) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("levels", "sentence"),
    [
        ((0, 100, 255), None),
        ((-1, 100, 100), "levels from 0 to 255"),
        ((0, 100, 256), "levels from 0 to 255"),
        ((0, 0, 2), "not all of them black"),
    ],
)
def test_colours_are_levels_of_a_picture(levels: tuple[int, ...], sentence: str | None) -> None:
    """A dark corner has level 0, and a nominal press of black has no colours."""
    cells = np.tile(np.array(levels, np.float64), (8, 8, 1))
    with nullcontext() if sentence is None else pytest.raises(ValueError, match=sentence):
        NominalColours(cells, 0.14)


def test_the_same_sensor_is_accepted_and_another_refused() -> None:
    """The message says what was found, what is accepted and what to do."""
    for same in ((150, 100, 50), (75, 50, 25), (156, 96, 48)):
        assert check_sensor(picture(*same), NOMINAL) is None
    found = check_sensor(picture(100, 100, 100), NOMINAL)
    assert found is not None
    assert found.reason is Reason.OTHER_SENSOR
    assert all(word in found.text for word in ("50.0%", "at most 14.0%", "fit again"))


def test_the_limit_itself_is_accepted() -> None:
    seen = picture(100, 100, 100)
    distance = colour_distance(colour_cells(seen, (8, 8)), CELLS)
    assert check_sensor(seen, NominalColours(CELLS, distance)) is None
    assert check_sensor(seen, NominalColours(CELLS, distance * (1 - 1e-9))) is not None


@pytest.mark.parametrize(
    ("cells", "limit", "what"),
    [
        (np.zeros((8, 8, 3)), 0.14, "black"),
        (np.full((8, 8, 3), 256.0), 0.14, "levels"),
        (np.ones((8, 8)), 0.14, "rows, columns, 3"),
        (CELLS, 0.0, "positive"),
        (CELLS, float("nan"), "positive"),
    ],
)
def test_nonsense_is_refused(cells: np.ndarray, limit: float, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        NominalColours(cells, limit)


COLUMNS, ROWS = np.meshgrid(np.linspace(-1, 1, 8), np.linspace(-1, 1, 8))
# Lamps on three sides: red from above, green from the right, blue from below.
LIT = np.stack([120 - 60 * ROWS, 120 + 50 * COLUMNS, 120 + 60 * ROWS], axis=-1)


BENT = 120 + 0.4 * (LIT - 120) + 25 * np.stack([COLUMNS * ROWS, -ROWS * COLUMNS, COLUMNS**2], axis=-1)


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        (LIT * [0.5, 1, 1], "the light has changed .red 0.50, green 1.00, blue 1.00 .*all lamps burn"),
        (BENT, "the gel was changed, or this is another unit.*gel replace"),  # the same pattern, flatter
        (np.ascontiguousarray(LIT[..., ::-1]), "this is another kind of sensor"),  # lamps elsewhere
        (LIT[..., [0, 2, 2]], "gel, light or sensor is another one"),  # green runs as blue does
    ],
)
def test_the_likely_cause_is_named(seen: np.ndarray, cause: str) -> None:
    """A gain of its own for each colour, another gel of the same kind, or colours that run otherwise."""
    nominal = NominalColours(LIT, 0.05)
    assert colour_distance(seen, LIT) > nominal.limit
    assert re.match(f"(most likely )?{cause}", likely_cause(seen, nominal))
