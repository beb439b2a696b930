"""The coarse colours of nominal presses, by which the gateway refuses frames of another kind of sensor."""

from typing import Final

import numpy as np

from edge.core.arrays import U8
from edge.core.imaging.quality import BLACK_LEVEL
from edge.core.imaging.sensor_check import check_sensor, colour_cells, colour_distance
from edge.model.manifest import ColourEntry

__all__ = ["CELLS", "colour_warnings", "nominal_colours", "refuses"]

CELLS: Final = (8, 8)
"""Cells of the region, rows and columns. 4 x 4 brings foreign frames nearer (19.0 % instead of 19.8 %), 14 x 14 shows
the dots of marker gels and gains nothing (20.6 %)."""

LEAST_LIMIT: Final = 0.14
"""Measured on the central 224 x 224 of 320 x 240, in percent of the light, largest distance first learnt then seen:

- real presses of a ball on one unit, two thirds learnt, one third held out: 1.7 to 2.4 on four sets; between two sets
  of one unit 2.3. Four other imprints of one unit and its free gel on another day: 3.3 to 6.0. A fingertip that shears
  a marker gel: 9.1.
- simulated parts with drifting lamps, sound and damaged: 3.4 with a plain, marker or remembering gel, also where the
  gel is new when learnt and worn by 1500 presses when seen; 6.3 with tilted presses that touch in part.
- frames of other sensors: 19.8 for the nearest, one lamp of a bench sensor in grey; 24.6 to 75 for all others (grey
  bench sensors, 9DTact, DM-Tac, DIGIT, Tac3D, two home-built sensors, one held by a finger, screws under a camera).

So the least limit is 1.5 times the largest distance of one unit and two thirds of the nearest other sensor. Other units
of the same model are at 3 to 21, with a marker gel at 9 to 37: some are accepted and some are refused.
"""

LIMIT_FACTOR: Final = 2.0
"""The limit is at least this many times the largest distance of a nominal press from the others: where an imprint
fills the region the presses themselves differ. Scored presses reached 1.5 times it where it is beyond the least limit
(simulated parts, regions of 64 to 224)."""

NEAREST_OTHER: Final = 0.198
"""The nearest frame of another sensor, as above: a limit beyond it may let one pass."""

_LEAST_COLOUR: Final = 1.0
"""Grey levels between the mean colours of a cell, of the cell that has most colour. Compression of a grey picture
leaves less; on real presses of a GelSight Mini it is above 40."""


def nominal_colours(frames: U8) -> ColourEntry | None:
    """The coarse colours of the presses, and the largest distance from them. frames: uint8 (n, h, w, 3), n at least 1.

    None where they are black: then there is no colour to compare with.
    """
    cells = np.stack([colour_cells(np.ascontiguousarray(rgb), CELLS) for rgb in frames])
    mean = cells.mean(axis=0)
    if mean.mean() < BLACK_LEVEL:
        return None
    n = len(cells)
    others = [(mean * n - cell) / (n - 1) if n > 1 else mean for cell in cells]
    spread = max(colour_distance(cell, rest) for cell, rest in zip(cells, others, strict=True))
    rounded = np.round(mean, 2).tolist()
    return ColourEntry(
        cells=tuple(tuple((r, g, b) for r, g, b in row) for row in rounded),
        spread=round(spread, 4),
        limit=round(max(LEAST_LIMIT, LIMIT_FACTOR * spread), 4),
    )


def colour_warnings(colours: ColourEntry | None) -> list[str]:
    """Warnings where presses are grey, or differ so much that another sensor may look like one of them."""
    if colours is None:
        return []
    if np.ptp(np.array(colours.cells), axis=2).max() < _LEAST_COLOUR:
        return [
            "these presses have no colour, and a GelSight Mini lights the gel in three colours: its frames will be "
            "refused or fail; give the pictures as the camera took them"
        ]
    if colours.limit <= NEAREST_OTHER:
        return []
    return [
        f"the colours of these presses differ by {colours.spread:.1%} of the light, so frames of another sensor up to "
        f"{colours.limit:.1%} are not refused; give presses of one sensor, or a region that the part does not fill"
    ]


def refuses(colours: ColourEntry | None, rgb: U8) -> bool:
    """Tell whether the gateway refuses a frame, uint8 (h, w, 3), for its colours; never where no colours are known."""
    return colours is not None and check_sensor(rgb, colours.nominal()) is not None
