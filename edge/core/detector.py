"""The interface of a detector: parameters, a fit, and a graph. See docs/architecture.md and docs/plugins.md.

A detector uses no files and no runtime. Its ONNX head takes the taps of the trunk and one input per bank array (same
name, unpacked dtype) and gives

    score_map  float32 (n, h, w)  raw, in pixels of the inspected region, higher is more anomalous
    score      float32 (n,)       the press's anomaly score, same meaning

Everything else (channel choice, pooling, distances, upsampling, smoothing) is inside the head, so the gateway has no
per-method code.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.tiles import Tiles

__all__ = [
    "Bank",
    "Detector",
    "Features",
    "Grid",
    "HasReference",
    "KeepsMean",
    "Mode",
    "Nominal",
    "Packing",
    "Progress",
    "ScoreMaps",
]

Features = Mapping[str, NDArray[np.float32]]
"""Tap name to feature map, float32 (n, c, h, w), as the trunk gives them."""

Mode = Literal["paper", "corrected"]
"""`paper` reproduces the seed paper's settings with their defects; `corrected` repairs each by a named switch."""

Packing = Literal["none", "float16", "int8"]
"""How an array is stored: unchanged, as float16, or as int8 with one float32 scale per row of its last axis."""

Progress = Callable[[float], None]
"""Called with the fraction done, 0 to 1."""


@dataclass(frozen=True)
class Grid:
    """The geometry that a head is built for."""

    frame: tuple[int, int]
    """(h, w) of the inspected region in pixels."""
    taps: Mapping[str, tuple[int, int, int]]
    """Tap name to (channels, h, w)."""
    pixels_per_mm: float
    """Scales physical sizes such as the blur."""
    tiles: Tiles | None = None
    """Set where the trunk sees the frame in overlapping tiles and gives its taps as mosaics of tiles; the head joins
    raw distances before it blurs."""

    def __post_init__(self) -> None:
        if self.tiles is not None and self.tiles.frame != self.frame:
            raise ValueError(f"the tiles are of a frame {self.tiles.frame}, the grid of {self.frame}")
        if not self.taps or min(self.frame) < 1:
            raise ValueError(f"a grid needs taps and a frame, found {self.frame} and {dict(self.taps)}")


@dataclass(frozen=True)
class Nominal:
    """The data of a fit: nominal presses alone."""

    features: Features
    """The features of n presses."""
    touched: NDArray[np.bool_] | None = None
    """bool (h, w) of the frame, True where any nominal press touches, None if unknown."""
    no_contact: Features | None = None
    """Features of the untouched gel (m >= 1 frames), None if there are none."""
    room: float = 1.0
    """A factor on every limit of the bank's size. For a fold it is the fold's share of the presses: otherwise its bank
    would hold more of each press than the final bank does. A bank that left out a place gets more than 1."""

    def __post_init__(self) -> None:
        if not self.room > 0:
            raise ValueError(f"the room of a bank is a positive factor, found {self.room}")

    @property
    def presses(self) -> int:
        return len(next(iter(self.features.values())))

    def limit(self, most: int | None) -> int | None:
        """A limit on the bank's size, by its room; at least 1, None where there is no limit."""
        return None if most is None else max(1, round(most * self.room))


@dataclass(frozen=True)
class Bank:
    """A normality bank."""

    arrays: Mapping[str, NDArray[Any]]
    """Name to array, in the dtype of the head's input of that name (float32, int64 or bool)."""
    packing: Mapping[str, Packing] = field(default_factory=dict)
    """How an array is stored; arrays not named are stored unchanged."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Results and choices of the fit, plain JSON (rank, ridge, seed, channel count, warnings), for the manifest."""


@dataclass(frozen=True)
class ScoreMaps:
    """The oracle's result."""

    score_map: NDArray[np.float64]
    """float64 (n, h, w)."""
    score: NDArray[np.float64]
    """float64 (n,). Higher is more anomalous."""


@runtime_checkable
class Detector(Protocol):
    """The object behind an entry point in `gelgate.detectors`. Optional: `HasReference`, `KeepsMean`.

    Parameters are one frozen value, a dataclass or a pydantic model, with `vars` that JSON can hold. The same ones go
    to `fit` and `head`, and into the manifest.
    """

    @property
    def name(self) -> str:
        """The method's name in manifests and messages; that of the entry point."""

    @property
    def compares_places(self) -> bool:
        """True where a press is compared with the same place of nominal ones, so that parts must be at one place."""

    @property
    def is_baseline(self) -> bool:
        """True for a baseline; baselines are left out of the default comparison of methods."""

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> Any:
        """The mode's parameters with overrides. Errors: FitError for an unknown name or a value out of range."""

    def taps(self, parameters: Any) -> tuple[str, ...]:
        """The taps that this detector reads, of those in the trunk."""

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: Any, rng: "np.random.Generator", progress: Progress
    ) -> Bank:
        """Learn the bank. Errors: FitError (no presses, non-finite features, nothing left after filtering)."""

    def head(self, grid: Grid, bank: Bank, parameters: Any) -> bytes:
        """The serialised ONNX graph for this grid. Imports onnx at use."""


@runtime_checkable
class KeepsMean(Protocol):
    """A detector whose bank holds what nominal presses are in the mean, and no press. People are then shown the mean
    beside a press, and otherwise the nominal press that looks most like it."""

    @property
    def keeps_mean(self) -> bool:
        """Say so: true."""


@runtime_checkable
class HasReference(Protocol):
    """A detector with a float64 oracle; `plugins.conformance.check_detector` compares the graph with it."""

    def reference_score(self, features: Features, grid: Grid, bank: Bank, parameters: Any) -> ScoreMaps:
        """Scores of n presses by readable NumPy in float64, with the same parameters as `fit` and `head`. Errors:
        NotScorable for features that are not finite."""
