"""Cells: what identifies a unit of a study."""

from dataclasses import replace

import pytest
from study_cells import cells

(CELL,) = cells(1)


def test_a_key_is_the_same_everywhere() -> None:
    """It is a hash of what the cell says, not of a process: rows of one machine continue on another."""
    assert CELL.key == "f30b0bc7a078a3b8"
    assert replace(CELL).key == CELL.key


@pytest.mark.parametrize(
    "change",
    [
        {"study": "resolution"},
        {"part": "PZ2"},
        {"position": "pos2"},
        {"method": "spade"},
        {"mode": "paper"},
        {"backbone": "other"},
        {"split": "specimen"},
        {"seed": 1},
        {"settings": (("shots", 2),)},
        {"settings": (("fraction", 1.0),)},
    ],
)
def test_every_field_is_part_of_the_key(change: dict[str, object]) -> None:
    """Two cells that differ anywhere have different keys."""
    assert replace(CELL, **change).key != CELL.key  # type: ignore[arg-type]


def test_settings_are_columns_of_their_own() -> None:
    """A row can be selected by `shots` as by `part`."""
    columns = CELL.columns()

    assert columns["shots"] == 1
    assert columns["key"] == CELL.key
    assert "settings" not in columns


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"split": "piece"}, "a split is by press or by specimen, found 'piece'"),
        ({"settings": (("b", 1), ("a", 1))}, "in the order of their names"),
        ({"settings": (("seed", 1),)}, "a setting has the name of a field: seed"),
    ],
)
def test_a_cell_refuses_nonsense(change: dict[str, object], said: str) -> None:
    """Equal cells must have equal keys, and columns must not hide each other."""
    with pytest.raises(ValueError, match=said):
        replace(CELL, **change)  # type: ignore[arg-type]
