"""Pieces with interruptions at every write: `tests/bench/pieces.py` has a thousand of them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from piece_world import NEVER, World

from edge.core.piece import Piece, PlacePress
from edge.features.piece import Pieces
from edge.press_stage import PressStage


def found(path: Path, pieces: int, order: str) -> dict[str, int]:
    """What must never be, after so many pieces."""
    world = World(path, 1, order)
    world.play(pieces)
    counts = world.audit()
    assert counts["kills"] > pieces / 8
    assert counts["verdict pass"] > pieces / 4
    return {name: counts[name] for name in NEVER if counts[name]}


@pytest.mark.parametrize("order", ["fixed", "free"])
def test_no_piece_passes_with_a_place_missing_and_none_is_lost_or_doubled(tmp_path: Path, order: str) -> None:
    """Killed before and after any write, with writes that fail, and an operator who makes mistakes."""
    assert found(tmp_path / "gelgate.db", 40, order) == {}


def take_any(piece: Piece, place: Any, press_id: str, word: str) -> Piece:
    return TAKE(piece, place, press_id, "pass" if word == "unsure" else word)


TAKE = Piece.take


@pytest.mark.parametrize(
    ("owner", "name", "planted"),
    [
        (Piece, "take", take_any),
        (PlacePress, "show", lambda press, word: word),
        (Pieces, "write", PressStage.write),
        (Pieces, "_lock", property(lambda pieces: None, lambda pieces, why: None)),
    ],
    ids=["an unsure press passes", "a place is a piece", "nothing is written", "the rest completes the next"],
)
def test_a_planted_fault_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: type, name: str, planted: Callable[..., Any]
) -> None:
    """By the audit, by what the outputs show, or because it never ends."""
    monkeypatch.setattr(owner, name, planted, raising=False)
    try:
        faults = found(tmp_path / "gelgate.db", 60, "free")
    except AssertionError:
        return
    assert faults
