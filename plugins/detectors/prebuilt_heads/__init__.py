"""Heads that come with the product, so that a fit with the usual settings needs no onnx package.

For each graph `index.json` has the detector, its parameters, the grid, and the bank's arrays. The graph fixes a size of
an array (a number) or leaves it open (a name; equal names are equal sizes). A head is used only where everything
matches; `make heads` writes them again.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from edge.core.detector import Bank, Detector, Grid
from plugins.detectors.common.parameters import Parameters

__all__ = [
    "INDEX",
    "PREBUILT_FRAMES",
    "PrebuiltHead",
    "identity",
    "load_index",
    "must_be_written",
    "prebuilt_head",
    "written_grid",
    "written_parameters",
]

INDEX = "index.json"
PREBUILT_FRAMES = ((224, 224), (240, 320))
"""(h, w) of the frames that heads ship for: the default region at low resolution, and the complete picture."""

FORMAT = 1
_HEADS = resources.files("plugins.detectors.prebuilt_heads")

Shape = tuple[int | str, ...]
"""The sizes of a bank array: numbers that the graph fixes, names for those that it leaves open."""


@dataclass(frozen=True)
class PrebuiltHead:
    """One graph and what it fits. detector: see `identity`. arrays: name to dtype and shape, of every bank array."""

    file: str
    detector: str
    parameters: Mapping[str, Any]
    grid: Mapping[str, Any]
    arrays: Mapping[str, tuple[str, Shape]]

    def fits(self, bank: Bank) -> bool:
        """Whether the bank has these arrays and no others, in the sizes that the graph fixes."""
        if bank.arrays.keys() != self.arrays.keys():
            return False
        open_sizes: dict[str, int] = {}
        for name, (dtype, shape) in self.arrays.items():
            array = bank.arrays[name]
            if str(array.dtype) != dtype or array.ndim != len(shape):
                return False
            for size, wanted in zip(array.shape, shape, strict=True):
                if size != (wanted if isinstance(wanted, int) else open_sizes.setdefault(wanted, size)):
                    return False
        return True

    def graph(self) -> bytes:
        """The serialised head. Errors: OSError for an installation that lacks the file."""
        return _HEADS.joinpath(self.file).read_bytes()


def prebuilt_head(detector: Detector, grid: Grid, bank: Bank, parameters: object) -> bytes | None:
    """The graph that `detector.head` would write, where it ships; None otherwise."""
    if grid.tiles is not None or not isinstance(parameters, Parameters):
        return None
    asked = (identity(detector), written_parameters(parameters), written_grid(grid))
    for head in load_index():
        if (head.detector, head.parameters, head.grid) == asked and head.fits(bank):
            return head.graph()
    return None


def must_be_written(detector: Detector, grid: Grid, parameters: object) -> bool:
    """Whether heads ship for this detector, but none for this grid and these parameters, whatever the bank."""
    known = [head for head in load_index() if head.detector == identity(detector)]
    if grid.tiles is not None or not isinstance(parameters, Parameters):
        return bool(known)
    asked = (written_parameters(parameters), written_grid(grid))
    return bool(known) and all((head.parameters, head.grid) != asked for head in known)


def identity(detector: Detector) -> str:
    """The class that writes the head: another plugin of the same name has heads of its own."""
    return f"{type(detector).__module__}.{type(detector).__qualname__}"


def written_parameters(parameters: Parameters) -> dict[str, Any]:
    """Parameters in the form of the index."""
    return parameters.model_dump(mode="json")


def written_grid(grid: Grid) -> dict[str, Any]:
    """A grid without tiles in the form of the index. A millionth of a pixel per mm is rounding."""
    return {
        "frame": list(grid.frame),
        "taps": {tap: list(shape) for tap, shape in grid.taps.items()},
        "pixels_per_mm": round(grid.pixels_per_mm, 6),
    }


@cache
def load_index() -> tuple[PrebuiltHead, ...]:
    """Every head that ships; none where the index is missing or has another format."""
    try:
        written = json.loads(_HEADS.joinpath(INDEX).read_text())
    except (OSError, ValueError):
        return ()
    if written.get("format") != FORMAT:
        return ()
    return tuple(
        PrebuiltHead(
            entry["file"],
            entry["detector"],
            entry["parameters"],
            entry["grid"],
            {name: (dtype, tuple(shape)) for name, (dtype, shape) in entry["arrays"].items()},
        )
        for entry in written["heads"]
    )
