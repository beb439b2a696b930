"""What is wrong in a table that a person wrote, told in sentences."""

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edge.core.suggest import suggestion
from edge.validation_messages import numbered, sentences


class Lamp(BaseModel):
    model_config = ConfigDict(extra="forbid")

    colour: str = "red"
    password: str = ""

    @model_validator(mode="after")
    def _dark(self) -> "Lamp":
        if self.colour == "black":
            raise ValueError("a lamp has a colour")
        return self


class Room(BaseModel):
    model_config = ConfigDict(extra="forbid")

    height_m: float
    lamps: list[Lamp] = []
    doors: tuple[Lamp, ...] = Field(default=(Lamp(),), min_length=1)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"height_m": 2, "lamp": []}, ["'room.lamp' is not known; did you mean 'lamps'?"]),
        ({"height_m": 2, "zzz": 1}, ["'room.zzz' is not known; known: height_m, lamps, doors"]),
        ({}, ["'room.height_m' is missing"]),
        ({"height_m": 2, "lamps": [{}, {"color": ""}]}, ["'room.lamps.1.color' is not known; did you mean 'colour'?"]),
        ({"height_m": 2, "lamps": [{"colour": "black", "password": "s3"}]}, ["'room.lamps.0': a lamp has a colour"]),
        ({"height_m": 2, "lamps": [7]}, ["'room.lamps.0' is 7: expected a table"]),
        ({"height_m": [{"password": "s3"}]}, ["'room.height_m': Input should be a valid number"]),
        ({"height_m": 2, "doors": [{"colour": 7}]}, ["'room.doors.0.colour' is 7: Input should be a valid string"]),
        ({"height_m": 2, "doors": []},
         ["'room.doors' is []: Tuple should have at least 1 item after validation, not 0"]),
    ],
)  # fmt: skip
def test_each_fault_is_told_with_its_whole_key(table: dict[str, object], told: list[str]) -> None:
    """The key as written in the file, what was found, and the nearest known name; a table's secrets stay unsaid."""
    with pytest.raises(ValidationError) as caught:
        Room.model_validate(table)

    assert sentences(Room, caught.value, "room") == told


def test_a_report_numbers_its_faults() -> None:
    """One line a fault, counted in the first line."""
    assert numbered("file x", ["one", "two"]) == "file x has 2 fault(s):\n  1. one\n  2. two"


def test_a_suggestion_is_the_nearest_name_or_all_of_them() -> None:
    """A near name is asked about; where none is near, up to 20 are listed; where none is known, that is said."""
    assert suggestion("mqt", ["jsonl", "mqtt"]) == "did you mean 'mqtt'?"
    assert suggestion("zebra", ["jsonl", "mqtt"]) == "known: jsonl, mqtt"
    assert suggestion("zebra", []) == "known: none"
    assert suggestion("zebra", map(str, range(300))).endswith(", 18, 19 and 280 more")
