"""Coverage: cells seen once, by place, on constructed features."""

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.acquisition.coverage import LEAST, MOST_CELLS, Coverage, PlaceDistances, rarefied


def covered(
    values: NDArray[np.float64], pieces: list[str] | None = None, touched: NDArray[np.bool_] | None = None
) -> Coverage:
    """values: (presses, cells) of one channel in one row."""
    distances = PlaceDistances()
    for k, row in enumerate(values):
        distances.add(row[None, None].astype(np.float32), touched, pieces[k] if pieces else None)
    found = distances.coverage()
    assert found is not None
    return found


def test_one_place_seen_once() -> None:
    """Five presses alike but for the left cell of the last: it is unseen in 1 of 10, there in 1 of 5. Two presses that
    show it so are no news."""
    values = np.zeros((6, 2))
    values[4:, 0] = 10
    found = covered(values[:5])
    assert found.near == 0
    assert found.unseen == pytest.approx(0.1)
    assert found.newest == pytest.approx(0.5)
    np.testing.assert_allclose(found.by_place, [[0.2, 0.0]])
    assert covered(values).unseen == 0


def test_a_piece_does_not_cover_itself() -> None:
    """Piece a is pressed twice and looks different: with its pieces known, both its presses are new."""
    values = np.zeros((7, 1))
    values[:2] = 10
    assert covered(values, list("aabcdef")).unseen == pytest.approx(2 / 7)
    assert covered(values).unseen == 0


def test_untouched_cells_do_not_count() -> None:
    """The right half of the frame is not touched: what is new there is not counted."""
    values = np.zeros((5, 2))
    values[4, 1] = 10
    touched = np.zeros((8, 8), np.bool_)
    touched[:, :4] = True
    found = covered(values, touched=touched)
    assert found.unseen == 0
    assert np.isnan(found.by_place[0, 1])


@pytest.mark.parametrize("pieces", [None, list("aabc")])
def test_fewer_than_four_pieces_have_no_coverage(pieces: list[str] | None) -> None:
    distances = PlaceDistances()
    for k in range(LEAST - 1 if pieces is None else 4):
        distances.add(np.full((1, 2, 2), k, np.float32), None, pieces[k] if pieces else None)
    assert distances.coverage() is None


def test_the_curve_is_the_mean_over_all_subsets() -> None:
    """Against counting: of every subset of 7 pieces, which members find no near neighbour in it."""
    values = np.random.default_rng(0).normal(size=(7, 3))
    found = covered(values)
    is_near = np.abs(values[:, None] - values[None]) <= found.near
    for m in range(1, 8):
        shares = [
            np.mean([[not is_near[i, [j for j in s if j != i], c].any() for c in range(3)] for i in s])
            for s in combinations(range(7), m)
        ]
        assert found.curve[m - 1] == pytest.approx(np.mean(shares), abs=1e-6)
    assert found.curve[-1] == pytest.approx(found.unseen)


def test_a_curve_of_cells_that_all_have_neighbours_ends_at_nothing() -> None:
    """All cells near all others: unseen with one piece, seen with two."""
    np.testing.assert_allclose(rarefied(np.array([0.0, 0.0, 0.0, 1.0])), [1, 0, 0, 0])


def test_large_maps_are_averaged() -> None:
    """A map of 70x56 becomes 23x18: three cells a side, and what does not fill a square is left out. A press of another
    region cannot be compared."""
    distances = PlaceDistances()
    for k in range(LEAST):
        distances.add(np.full((2, 70, 56), k, np.float32))
    found = distances.coverage()
    assert found is not None
    assert found.neighbours.shape == (LEAST, 23, 18)
    assert max(found.neighbours.shape[1:]) <= MOST_CELLS
    with pytest.raises(ValueError, match="features are"):
        distances.add(np.zeros((2, 70, 60), np.float32))
