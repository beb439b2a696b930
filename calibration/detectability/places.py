"""The places of a contact: a grid over the inspected region, and spots in it where a press touches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.rendered_damage.damage import Spot
from calibration.simulator.field_of_view import Field, grids

__all__ = ["Place", "PlaceGrid", "touched_places"]

# A press touches a place where it touches this share of it; a place is of the contact where half of the presses do.
_TOUCHED_SHARE = 0.1
_PRESSES_SHARE = 0.5


@dataclass(frozen=True, order=True)
class Place:
    """One cell of the grid, by its row and column."""

    row: int
    column: int


@dataclass(frozen=True)
class PlaceGrid:
    """Equal cells over a field, about `spacing_mm` wide. Errors: ValueError for a spacing that is not positive."""

    field: Field
    spacing_mm: float

    def __post_init__(self) -> None:
        if not self.spacing_mm > 0:
            raise ValueError(f"the spacing of places is positive, found {self.spacing_mm} mm")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        across, down = (max(1, round(extent / self.spacing_mm)) for extent in self.field.extent_mm)
        return down, across

    def middle_mm(self, place: Place) -> tuple[float, float]:
        """The middle of a place: x right and y down from the middle of the region."""
        (rows, columns), (width, height) = self.shape, self.field.extent_mm
        return ((place.column + 0.5) / columns - 0.5) * width, ((place.row + 0.5) / rows - 0.5) * height

    def pixels(self, place: Place) -> tuple[slice, slice]:
        """The rows and columns of pixels of a place."""
        sides = zip((place.row, place.column), self.shape, self.field.shape, strict=True)
        down, across = (slice(round(k * size / n), round((k + 1) * size / n)) for k, n, size in sides)
        return down, across

    def touched(self, contact: NDArray[np.bool_], place: Place) -> bool:
        """Whether a press with this contact, bool (h, w), touches the place."""
        return bool(contact[self.pixels(place)].mean() >= _TOUCHED_SHARE)

    def spot(self, contact: NDArray[np.bool_], place: Place, rng: np.random.Generator) -> Spot | None:
        """A spot in the place where the press touches, with any direction; None where it does not touch it."""
        cell = self.pixels(place)
        if not self.touched(contact, place):
            return None
        x, y = (axis[cell][contact[cell]] for axis in grids(self.field))
        pick = rng.integers(len(x))
        return Spot(float(x[pick]), float(y[pick]), float(rng.uniform(0, math.pi)))


def touched_places(grid: PlaceGrid, contacts: Sequence[NDArray[np.bool_]]) -> tuple[Place, ...]:
    """The places that at least half of the presses touch, row by row. contacts: bool (h, w) each."""
    rows, columns = grid.shape
    return tuple(
        place
        for place in (Place(row, column) for row in range(rows) for column in range(columns))
        if np.mean([grid.touched(contact, place) for contact in contacts]) >= _PRESSES_SHARE
    )
