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
def test_folds_hold_out_every_press_once_and_keep_specimens_whole(
    specimens: list[str | None], count: int, seed: int
) -> None:
    """The folds are a partition; presses of one specimen are never on both sides."""
    parts = folds(specimens, count, np.random.default_rng(seed))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(specimens)))
    assert 1 <= len(parts) <= count
    for part in parts:
        named = {specimens[k] for k in part} - {None}
        rest = {specimens[k] for k in range(len(specimens)) if k not in part}
        assert not named & rest


def test_folds_are_of_nearly_equal_size() -> None:
    """Twelve single presses in five folds: none holds more than three."""
    assert sorted(len(p) for p in folds([None] * 12, 5, np.random.default_rng(0))) == [2, 2, 2, 3, 3]


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


@pytest.mark.parametrize(("n", "count"), [(4, 4), (9, 9), (10, 5)])
def test_below_ten_presses_each_is_held_out_alone(n: int, count: int) -> None:
    """Nine folds of nine presses, five of ten."""
    parts, said = divide_presses([None] * n, 5, np.random.default_rng(0))
    assert (len(parts), said) == (count, [])


@pytest.mark.parametrize("names", ["aaaabbbb", "aaaaaaaa"])
def test_of_one_or_two_pieces_presses_are_held_out_and_it_is_said(names: str) -> None:
    """A bank of one piece does not show how pieces differ: its scores would not match the final bank's."""
    parts, said = divide_presses(list(names), 5, np.random.default_rng(0))
    assert {len(part) for part in parts} == {1}
    assert "knows nothing of other pieces" in said[0]


def test_a_piece_that_is_nearly_all_presses_is_not_held_out_whole() -> None:
    """Ten presses of one piece and one each of two others: without the first, two presses were left."""
    parts, said = divide_presses([*"aaaaaaaaaabc"], 5, np.random.default_rng(0))
    assert min(12 - len(part) for part in parts) >= 3
    assert said


def test_where_one_press_is_enough_two_pieces_are_held_out_in_turn() -> None:
    """With copies of the presses a bank of one piece shows how presses differ: no warning, a fold for each piece."""
    rng = np.random.default_rng(0)
    found, said = divide_presses(("a", "b", "b"), 5, rng, fewest=2)

    assert said == []
    assert sorted(held.tolist() for held in found) == [[0], [1, 2]]
    assert divide_presses(("a", "b", "b", "b"), 5, rng)[1] != []
