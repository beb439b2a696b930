"""A study's cells: independent units of work, each with a key that is the same on every machine and in every run."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from edge.core.detector import Mode

__all__ = ["Cell", "Result", "Setting", "Split"]

# Of the key: a change in what a cell means gives it another key, so that old rows are not taken for new ones.
CELL_FORMAT = 1

Setting = str | int | float

Split = Literal["press", "specimen"]
"""`press`: presses are drawn alone, as in the paper. `specimen`: all presses of a specimen are on one side."""


@dataclass(frozen=True)
class Cell:
    """One independent unit of a study: what is fitted and what is scored.

    part, position: as in the dataset.
    """

    study: str
    """The study's name, such as `good-fraction`."""
    part: str
    position: str
    method: str
    """The detector's name."""
    mode: Mode
    backbone: str
    """An installed backbone or a trunk .onnx file, as given by the user."""
    split: Split
    """How test presses are held out, `press` or `specimen`."""
    seed: int
    """Fixes every random choice of the cell."""
    settings: tuple[tuple[str, Setting], ...] = ()
    """What else the study varies, as pairs in the order of their names."""

    def __post_init__(self) -> None:
        if self.split not in get_args(Split):
            raise ValueError(f"a split is by press or by specimen, found '{self.split}'")
        if list(self.settings) != sorted(self.settings):
            raise ValueError(f"settings are in the order of their names, found {self.settings}")
        if taken := set(dict(self.settings)) & set(self.__dataclass_fields__):
            raise ValueError(f"a setting has the name of a field: {', '.join(sorted(taken))}")

    @property
    def key(self) -> str:
        """SHA-256 of everything that the cell says, 16 digits."""
        text = json.dumps([CELL_FORMAT, asdict(self)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def setting(self, name: str) -> Setting:
        """Return a setting. Errors: KeyError."""
        return dict(self.settings)[name]

    def columns(self) -> Mapping[str, Any]:
        """The fields of a row that name the cell: its key, its fields, and its settings as columns of their own."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "settings"}
        return {"key": self.key, **fields, **dict(self.settings)}


Result = tuple[Cell, Mapping[str, Any]]
"""A cell, and the columns that it measures."""
