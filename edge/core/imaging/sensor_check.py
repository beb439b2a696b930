"""Checks by coarse colours, before scoring, whether a press is from the sensor of the nominal presses.

The lights of a sensor paint its gel in the same coarse colours at every press; an imprint changes few of them. A
tactile trunk depends on the imprint more than on the light, so a score does not distinguish sensors.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import F32, F64, U8
from edge.core.imaging.quality import Reason, Rejection
from edge.core.printable import score_texts
from edge.core.sentence import Sentence

__all__ = [
    "NominalColours",
    "check_sensor",
    "colour_cells",
    "colour_distance",
    "is_other_kind",
    "is_same_kind",
    "likely_cause",
]

# Correlation of the colours over the gel. Between public frames of seven units of one kind it is 0.71 to 0.99; between
# that kind and five others -0.38 to 0.35, and 0.63 to 0.78 for one that has the same lamps.
_SAME_KIND: Final = 0.7
_OTHER_KIND: Final = 0.5
# Between units of one kind colours differ by 3 to 21 % (docs/bundle.md), between kinds by 25 % and more.
_FARTHEST_OF_KIND: Final = 0.22
_COLOURS: Final = ("red", "green", "blue")

# The smallest level of a nominal cell in a ratio: a black corner has no ratio.
_LEAST_LEVEL: Final = 1.0
# Sixty-four times darker than nominal is black, which no lamp's gain explains.
_LEAST_GAIN: Final = 1 / 64


@dataclass(frozen=True)
class NominalColours:
    """The coarse colours of nominal presses."""

    cells: F64
    """Levels, float64 (rows, columns, 3) RGB over the inspected region."""
    limit: float
    """The largest `colour_distance` of a press from the same sensor."""

    def __post_init__(self) -> None:
        if self.cells.ndim != 3 or self.cells.shape[2] != 3 or not self.cells.size:
            raise ValueError(f"colours are (rows, columns, 3), found {self.cells.shape}")
        if not (self.cells.min() >= 0 and self.cells.max() <= 255 and self.cells.mean() >= _LEAST_LEVEL):
            raise ValueError("colours are levels from 0 to 255, and not all of them black")
        if not self.limit > 0:
            raise ValueError(f"a limit is positive, found {self.limit}")


def colour_cells(rgb: U8, shape: tuple[int, int]) -> F64:
    """The mean colour of each of (rows, columns) equal cells, in whole levels. rgb: uint8 (h, w, 3)."""
    rows, columns = shape
    return np.asarray(cv2.resize(rgb, (columns, rows), interpolation=cv2.INTER_AREA), np.float64)


def colour_distance(cells: F64, nominal: F64) -> float:
    """The distance of two sets of coarse colours, as a fraction of the nominal light.

    One common gain is taken out, the median over cells of the ratio of light, so dim or warm lamps do not count. Of the
    residue the largest of the three channels counts in each cell, and of the cells the median. So an imprint on less
    than half of the region changes little.
    """
    light = nominal.mean(axis=2)
    gain = float(np.median(cells.mean(axis=2) / np.maximum(light, _LEAST_LEVEL)))
    residue = np.abs(cells / max(gain, _LEAST_GAIN) - nominal).max(axis=2)
    return float(np.median(residue) / light.mean())


def check_sensor(rgb: U8, nominal: NominalColours) -> Rejection | None:
    """Another sensor, gel or light, or None. rgb: uint8 (h, w, 3), the inspected region."""
    rows, columns = nominal.cells.shape[:2]
    cells = colour_cells(rgb, (rows, columns))
    apart = colour_distance(cells, nominal.cells)
    if apart <= nominal.limit:
        return None
    distance, limit = score_texts(apart, nominal.limit, 1, "%")
    text = Sentence(
        f"the colours differ by {distance} of the light from those of the nominal presses, at most "
        f"{limit} is accepted; {likely_cause(cells, nominal)}"
    )
    return Rejection(Reason.OTHER_SENSOR, text)


def likely_cause(cells: F64, nominal: NominalColours) -> Sentence:
    """Say what most likely made the colours differ, and what to do about it: light, gel or unit, or kind of sensor.

    A gain of its own for each colour that explains all is the light. Where the colours still lie in the same pattern
    over the gel it is a gel or a unit of the same kind, which colours do not tell apart.
    """
    pattern = _common_pattern(cells, nominal.cells)
    gains = np.median(cells / np.maximum(nominal.cells, _LEAST_LEVEL), axis=(0, 1))
    balanced = cells / np.maximum(gains, _LEAST_GAIN)
    if is_other_kind(cells, nominal):
        return Sentence(
            "most likely this is another kind of sensor: check that it is the one learnt, or fit again on it"
        )
    if colour_distance(balanced, nominal.cells) <= nominal.limit:
        shares = ", ".join(f"{name} {gain:.2f}" for name, gain in zip(_COLOURS, gains, strict=True))
        return Sentence(
            f"most likely the light has changed ({shares} of what was learnt): check that all lamps burn, with white "
            "balance and exposure as at the fit, or fit again"
        )
    if pattern >= _SAME_KIND:
        return Sentence(
            "most likely the gel was changed, or this is another unit of the same kind: record a change with "
            "`gelgate gel replace`, then say what the presses are that the station asks about, for `gelgate bundle "
            "learn`; or fit again on the new gel"
        )
    return Sentence(
        "gel, light or sensor is another one: check that this is the sensor that was learnt and that all its lights "
        "burn, or fit again on it"
    )


def is_same_kind(view: F32, known: F32) -> bool:
    """Tell whether two pictures of a free gel, float32 (h, w, 3), may be of units of one kind of sensor."""
    cells, nominal = (
        np.asarray(cv2.resize(one, (8, 8), interpolation=cv2.INTER_AREA), np.float64) for one in (view, known)
    )
    return (
        _common_pattern(cells, nominal) >= _SAME_KIND and colour_distance(cells, nominal) <= _FARTHEST_OF_KIND
    )


def is_other_kind(cells: F64, nominal: NominalColours) -> bool:
    """Tell whether the colours run over the gel otherwise than with any unit of this kind of sensor."""
    return _common_pattern(cells, nominal.cells) < _OTHER_KIND


def _common_pattern(cells: F64, nominal: F64) -> float:
    """Measure how alike the colours run over the gel: the mean correlation of the channels, -1 to 1."""
    flat, known = (one.reshape(-1, 3) - one.reshape(-1, 3).mean(axis=0) for one in (cells, nominal))
    scale = np.sqrt((flat**2).sum(axis=0) * (known**2).sum(axis=0))
    return float(np.mean((flat * known).sum(axis=0) / np.maximum(scale, 1e-9)))
