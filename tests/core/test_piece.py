"""The rule of a piece: what fills a place, what is pressed next, and its verdict."""

import itertools

import pytest

from edge.core.errors import ConfigError
from edge.core.part_position import PartPosition
from edge.core.piece import Order, Piece, PlacePress, check_places

A, B, C = (PartPosition("bolt", name) for name in ("left", "middle", "right"))
PLAN = (A, B, C)
WORDS = ("pass", "fail", "unsure", "rejected", "error")


def pressed(*presses: tuple[PartPosition, str], order: Order = "free") -> Piece:
    piece = Piece("P1", 0, PLAN, order)
    for number, (place, word) in enumerate(presses):
        piece = piece.take(place, str(number), word)
    return piece


@pytest.mark.parametrize("order", ["free", "fixed"])
def test_a_piece_passes_only_where_each_place_has_passed(order: Order) -> None:
    """Every series of three presses, at every place with every word: whatever was pressed in between."""
    for presses in itertools.product(itertools.product(PLAN, WORDS), repeat=3):
        piece = pressed(*presses, order=order)
        words = {place: [word for at, word in presses if at == place] for place in PLAN}
        if piece.verdict == "pass":
            assert [words[place] for place in PLAN] == [["pass"]] * 3
        if piece.verdict == "incomplete":
            assert piece.missing
        assert (piece.verdict == "fail") == piece.has_failed


@pytest.mark.parametrize("word", ["unsure", "rejected", "error"])
def test_a_press_without_a_decision_leaves_its_place_open(word: str) -> None:
    """The place is pressed again, and its next press decides it."""
    piece = pressed((A, word), (A, "pass"))

    assert pressed((A, word)).missing == PLAN
    assert piece.missing == (B, C)


def test_a_fail_is_not_pressed_away() -> None:
    """The first press that decided a place stays."""
    assert pressed((A, "fail"), (A, "pass"), (B, "pass"), (C, "pass")).verdict == "fail"


def test_a_fixed_order_expects_one_place() -> None:
    assert pressed(order="fixed").expected == (A,)
    assert pressed((B, "pass"), (A, "pass"), order="fixed").expected == (B,)
    assert pressed((B, "pass")).expected == (A, C)


@pytest.mark.parametrize(
    ("word", "has_failed", "is_last", "shown"),
    [
        ("pass", False, False, None),
        ("pass", False, True, "pass"),
        ("pass", True, False, "fail"),
        ("pass", True, True, "fail"),
        ("fail", False, False, "fail"),
        ("unsure", True, True, "unsure"),
        ("rejected", False, False, "rejected"),
        ("error", False, True, "error"),
    ],
)
def test_outputs_pass_a_whole_piece(word: str, has_failed: bool, is_last: bool, shown: str | None) -> None:
    """A fail is shown at once, and by every further press of the piece."""
    assert PlacePress("P1", A, False, has_failed, is_last).show(word) == shown


def test_a_place_without_a_bundle_is_named() -> None:
    known = {"bolt/left": {A}, "bolt/right": {C}}
    with pytest.raises(
        ConfigError, match=r"no bundle for bolt/middle; add one to \[inspection\], or take the place"
    ):
        check_places(PLAN, lambda name: known.get(name, set()))
