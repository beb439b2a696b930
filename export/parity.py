"""Shows that a bundle computes what the research model computes: both are compared stage by stage.

The stages are in the order of the computation, so the first one that differs says where to look. A stage is compared
by its largest difference, relative to its largest expected value; the order of the presses by its rank correlation.

    stages = [Stage("input", expected, found, "input"), Stage("map", maps, bundle_maps, "map")]
    report = compare([*stages, order_stage(scores, bundle_scores)])
    report.write(folder)
    report.raise_if_different()
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import BundleCorrupt
from export.stages import ORDER_LEAST, TOLERANCES, Kind, Stage, StageResult

__all__ = [
    "ORDER_LEAST",
    "TOLERANCES",
    "Kind",
    "ParityReport",
    "Stage",
    "StageResult",
    "compare",
    "order_stage",
    "rank_correlation",
]

Array = NDArray[Any]


@dataclass(frozen=True)
class ParityReport:
    """The results in the order of the computation, and the maps of both models (n, h, w) for the pictures.

    frames: uint8 (n, h, w, 3), shown next to the maps.
    """

    results: tuple[StageResult, ...]
    maps: tuple[Array, Array] | None = None
    frames: NDArray[np.uint8] | None = None
    title: str = "Parity"
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def first_different(self) -> StageResult | None:
        """The first stage outside its tolerance."""
        return next((result for result in self.results if not result.is_equal), None)

    @property
    def is_equal(self) -> bool:
        return self.first_different is None

    def raise_if_different(self) -> None:
        """Raise BundleCorrupt with the first stage that differs, and its numbers."""
        first = self.first_different
        if first is not None:
            before = [result.name for result in self.results[: self.results.index(first)]]
            agreed = f"equal before it: {', '.join(before)}" if before else "it is the first stage"
            raise BundleCorrupt(f"the bundle differs from the research model: {first.sentence()} ({agreed})")

    def write(self, folder: Path) -> Path:
        """Write `parity.html`, one file without links, and return its path. Errors: OSError."""
        from edge.model.archive import write_file
        from export.parity_page import page  # OpenCV, for the pictures alone

        path = folder / "parity.html"
        write_file(path, page(self.title, self.results, self.facts, self.maps, self.frames).encode())
        return path


def compare(
    stages: Sequence[Stage],
    *,
    frames: NDArray[np.uint8] | None = None,
    title: str = "Parity",
    facts: Mapping[str, str] | None = None,
) -> ParityReport:
    """Compare every stage, also those after the first that differs.

    frames: the pictures, for the report. Errors: ValueError for no stage at all.
    """
    if not stages:
        raise ValueError("no stage was given; give at least the map and the score")
    shown = next((stage for stage in stages if stage.kind == "map"), None)
    maps = (
        None if shown is None or shown.expected.shape != shown.found.shape else (shown.expected, shown.found)
    )
    return ParityReport(tuple(map(_result, stages)), maps, frames, title, dict(facts or {}))


def order_stage(expected: Array, found: Array, least: float = ORDER_LEAST) -> Stage:
    """The stage that compares the order of the presses. expected, found: scores (n,)."""
    return Stage("order of the presses", np.asarray(expected), np.asarray(found), "order", least)


def _result(stage: Stage) -> StageResult:
    expected, found = np.asarray(stage.expected), np.asarray(stage.found)
    fault = _fault(expected, found, stage.kind)
    if fault:
        return StageResult(stage.name, stage.kind, expected.shape, float("inf"), stage.allowed, fault=fault)
    if stage.kind == "order":
        return StageResult(
            stage.name, stage.kind, expected.shape, rank_correlation(expected, found), stage.allowed
        )
    expected, found = expected.astype(np.float64), found.astype(np.float64)
    apart = np.abs(expected - found)
    at = tuple(int(i) for i in np.unravel_index(int(apart.argmax()), apart.shape))
    scale = max(float(np.abs(expected).max()), float(np.finfo(np.float32).tiny))
    return StageResult(
        name=stage.name,
        kind=stage.kind,
        shape=expected.shape,
        difference=float(apart[at]) / scale,
        allowed=stage.allowed,
        at=at,
        expected=float(expected[at]),
        found=float(found[at]),
    )


def _fault(expected: Array, found: Array, kind: Kind) -> str:
    if expected.shape != found.shape:
        return f"has shape {found.shape}, the research model gives {expected.shape}"
    if expected.size == 0 or (kind == "order" and expected.ndim != 1):
        return f"has shape {expected.shape} and cannot be compared"
    for whose, array in (("the research model", expected), ("the bundle", found)):
        if array.dtype.kind not in "fiub" or not np.isfinite(array).all():
            return f"holds values of {whose} that are not finite numbers ({array.dtype})"
    return ""


def rank_correlation(a: Array, b: Array) -> float:
    """Spearman's rank correlation of two series (n,); equal values share their mean rank. 1 where both are constant."""
    ranks = [_ranks(np.asarray(values, np.float64)) for values in (a, b)]
    spread = [float(np.std(values)) for values in ranks]
    if min(spread) == 0.0:
        return 1.0 if max(spread) == 0.0 else 0.0
    centred = [values - values.mean() for values in ranks]
    return float(np.mean(centred[0] * centred[1]) / (spread[0] * spread[1]))


def _ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count).astype(np.float64)
    mean: NDArray[np.float64] = (last - (count - 1) / 2)[group]
    return mean
