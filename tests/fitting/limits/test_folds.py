"""Folds: every press held out once, pieces complete, and always at least three presses left."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.fitting.limits.folds import divide_presses, folds


@given(
    st.lists(st.sampled_from(["a", "b", "c", "d", None]), min_size=1, max_size=30),
    st.integers(1, 6),
    st.integers(0, 9),
)
@settings(max_examples=100, deadline=None)
def test_folds_partition_presses_and_specimens(specimens: list[str | None], count: int, seed: int) -> None:
    """The folds are a partition; presses of one specimen are never on both sides."""
    parts = folds(specimens, count, np.random.default_rng(seed))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(specimens)))
    assert 1 <= len(parts) <= count
    for part in parts:
        named = {specimens[k] for k in part} - {None}
        rest = {specimens[k] for k in range(len(specimens)) if k not in part}
        assert not named & rest


@given(
    st.lists(st.sampled_from(["a", "b", "c", None]), min_size=4, max_size=30),
    st.integers(2, 6),
    st.integers(0, 9),
)
@settings(max_examples=100, deadline=None)
def test_every_fold_leaves_three_presses(specimens: list[str | None], count: int, seed: int) -> None:
    """For any pieces, from four presses on."""
    parts, _ = divide_presses(specimens, count, np.random.default_rng(seed))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(specimens)))
    assert min(len(specimens) - len(part) for part in parts) >= 3


@pytest.mark.parametrize(
    ("specimens", "sizes", "is_said"),
    [
        ([None] * 4, [1] * 4, False),
        ([None] * 9, [1] * 9, False),
        ([None] * 10, [2] * 5, False),
        ([None] * 12, [2, 2, 2, 3, 3], False),
        ([*"aaaabbbb"], [4, 4], False),
        ([*"aabb"], [1] * 4, True),
        ([*"aaaaaaaa"], [1] * 8, True),
        ([*"aaaaaaaaaabc"], None, True),
    ],
)
def test_presses_are_held_out_alone_where_pieces_cannot_be(
    specimens: list[str | None], sizes: list[int] | None, is_said: bool
) -> None:
    """Below ten presses each alone, then folds of nearly equal size. Two pieces are held out in turn. Of one piece, or
    where one is nearly all presses, presses are held out, and it is said: that does not show how pieces differ."""
    parts, said = divide_presses(specimens, 5, np.random.default_rng(0))
    assert sizes is None or sorted(map(len, parts)) == sizes
    assert ["sound presses of any other may fail" in one for one in said] == [True] * is_said


def test_where_one_press_is_enough_two_pieces_are_held_out_in_turn() -> None:
    """With copies of the presses a bank of one piece shows how presses differ: no warning, a fold for each piece."""
    rng = np.random.default_rng(0)
    found, said = divide_presses(("a", "b", "b"), 5, rng, fewest=2)

    assert said == []
    assert sorted(held.tolist() for held in found) == [[0], [1, 2]]
    assert divide_presses(("a", "b", "b", "b"), 5, rng)[1] != []
