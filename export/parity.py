"""Shows that a bundle computes what the research model computes: both are compared stage by stage.

The stages are in the order of the computation, so the first one that differs says where to look. A stage is compared
by its largest difference, relative to its largest expected value; the order of the presses by its rank correlation.

    stages = [Stage("input", expected, found, "input"), Stage("map", maps, bundle_maps, "map")]
    report = compare([*stages, order_stage(scores, bundle_scores)])
    report.write(folder)
    report.raise_if_different()
"""

import base64
import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, U8
from edge.core.errors import BundleCorrupt
from edge.model.bundle_writer import write_file
from edge.model.scorer import Scorer
from edge.pictures.heatmap import FULL_SCALE, paint_scores
from edge.pictures.image_file import encode

__all__ = [
    "ORDER_LEAST",
    "TOLERANCES",
    "Kind",
    "ParityReport",
    "Stage",
    "compare",
    "order_stage",
    "rank_correlation",
    "score_frames",
    "score_stages",
    "show_frames",
]

Array = NDArray[Any]
Maps = tuple[Array, Array]
"""Score maps (n, h, w) and scores (n,)."""

TOLERANCES: Mapping[str, float] = {
    "input": 1e-5,
    "tap": 1e-4,
    "descriptor": 1e-4,
    "distance": 1e-3,
    "map": 1e-3,
    "score": 1e-3,
}
"""Allowed difference by kind of stage, relative to the largest expected value. Both sides compute in float32: a trunk
sums some thousand products per value (measured: 1e-6 to 3e-5), a distance loses digits where it is small."""

ORDER_LEAST = 0.9995
"""The least rank correlation of the scores: 1.000 to three digits."""

Kind = Literal["input", "tap", "descriptor", "distance", "map", "score", "order"]


MOST_SHOWN = 6
"""Frames with pictures: the page stays small enough to send."""

MOST_SIDE = 320

STYLE = """body{font-family:sans-serif;max-width:70em;margin:2em auto;color:#222}table{border-collapse:collapse}
td,th{padding:.3em .8em;border-bottom:1px solid #ccc;text-align:left}td.n{text-align:right;font-family:monospace}
.bad{color:#b00020;font-weight:bold}.good{color:#11691f}figure{display:inline-block;margin:.5em}
figcaption{font-size:.85em}"""


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of both models for the same frames, frames first, and how far it differs."""

    name: str
    expected: Array
    """From the research model; any real dtype."""
    found: Array
    """From the bundle; of the same shape (n, ...)."""
    kind: Kind = "tap"
    """Decides the usual tolerance."""
    tolerance: float | None = None
    """Another one, relative to the largest expected value; for `order`, the least rank correlation."""

    @property
    def allowed(self) -> float:
        if self.tolerance is not None:
            return self.tolerance
        return ORDER_LEAST if self.kind == "order" else TOLERANCES[self.kind]

    @cached_property
    def fault(self) -> str:
        """The reason why the stages cannot be compared, or empty."""
        expected, bundle_array = self.expected, self.found
        if expected.shape != bundle_array.shape:
            return f"has shape {bundle_array.shape}, the research model gives {expected.shape}"
        if expected.size == 0 or (self.kind == "order" and expected.ndim != 1):
            return f"has shape {expected.shape} and cannot be compared"
        for whose, array in (("the research model", expected), ("the bundle", bundle_array)):
            if array.dtype.kind not in "fiub" or not np.isfinite(array).all():
                return f"holds values of {whose} that are not finite numbers ({array.dtype})"
        return ""

    @cached_property
    def at(self) -> tuple[int, ...]:
        """The place of the largest difference."""
        apart = np.abs(self.expected.astype(np.float64) - self.found.astype(np.float64))
        return tuple(int(i) for i in np.unravel_index(int(apart.argmax()), apart.shape))

    @cached_property
    def difference(self) -> float:
        """The largest absolute difference over the largest expected value; for `order`, the rank correlation."""
        if self.fault:
            return float("inf")
        largest = float(np.abs(self.expected.astype(np.float64)).max())
        if self.kind == "order":  # scores that are equal within the tolerance have one rank
            same = np.isclose(self.found, self.expected, rtol=0, atol=TOLERANCES["score"] * largest)
            return rank_correlation(self.expected, np.where(same, self.expected, self.found))
        apart = abs(float(self.expected[self.at]) - float(self.found[self.at]))
        return apart / max(largest, float(np.finfo(np.float32).tiny))

    @property
    def is_equal(self) -> bool:
        if self.fault:
            return False
        is_order = self.kind == "order"
        return self.difference >= self.allowed if is_order else self.difference <= self.allowed

    def sentence(self) -> str:
        """Say how the stages compare."""
        if self.fault:
            return f"stage '{self.name}' {self.fault}"
        if self.kind == "order":
            return (
                f"stage '{self.name}': the rank correlation of {len(self.expected)} scores is {self.difference:.4f}, "
                f"at least {self.allowed:g} is expected"
            )
        expected, bundle_value = self.expected[self.at], self.found[self.at]
        return (
            f"stage '{self.name}': largest difference {self.difference:.2g} of the largest value at {self.at} "
            f"(expected {expected:.6g}, found {bundle_value:.6g}), {self.allowed:g} is allowed"
        )


@dataclass(frozen=True)
class ParityReport:
    """The stages in the order of the computation."""

    results: tuple[Stage, ...]
    frames: U8 | None = None
    """(n, h, w, 3), shown next to the maps."""
    title: str = "Parity"
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def first_different(self) -> Stage | None:
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
        path = folder / "parity.html"
        write_file(path, _page(self).encode())
        return path


def compare(
    stages: Sequence[Stage],
    *,
    frames: U8 | None = None,
    title: str = "Parity",
    facts: Mapping[str, str] | None = None,
) -> ParityReport:
    """Report on every stage, also those after the first that differs.

    frames: the pictures, for the report. Errors: ValueError for no stage at all.
    """
    if not stages:
        raise ValueError("no stage was given; give at least the map and the score")
    return ParityReport(tuple(stages), frames, title, dict(facts or {}))


def score_frames(scorer: Scorer, frames: Iterable[U8]) -> Maps:
    """Score frames (h, w, 3): maps (n, h, w) and scores (n,)."""
    scored = [scorer.score(frame) for frame in frames]
    maps = np.stack([press.score_map for press in scored])
    return maps, np.array([press.anomaly_score for press in scored])


def show_frames(scorer: Scorer, frames: Iterable[U8]) -> U8:
    """Return frames (h, w, 3) as the network sees them: prepared, in the bank's pose, uint8 (n, h, w, 3)."""
    prepared = [scorer.bundle.prepare(frame) for frame in frames]
    registered = [scorer.score_prepared(frame).registered for frame in prepared]
    return np.stack(
        [frame if placed is None else placed.rgb for frame, placed in zip(prepared, registered, strict=True)]
    )


def score_stages(expected: Maps, found: Maps, tolerance: float | None = None) -> list[Stage]:
    """Make the stages that compare maps and scores."""
    pairs = zip(("map", "score"), expected, found, strict=True)
    return [Stage(name, one, other, cast(Kind, name), tolerance) for name, one, other in pairs]


def order_stage(expected: Array, found: Array) -> Stage:
    """Make the stage that compares the order of the presses. expected, found: scores (n,)."""
    return Stage("order of the presses", expected, found, "order")


def rank_correlation(a: Array, b: Array) -> float:
    """Compute Spearman's correlation of two series (n,); equal values share their mean rank. 1: both are constant."""
    ranks = [_ranks(np.asarray(values, np.float64)) for values in (a, b)]
    constant = [bool(np.ptp(values) == 0) for values in ranks]
    return float(all(constant)) if any(constant) else float(np.corrcoef(ranks).flat[1])


def _ranks(values: F64) -> F64:
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count).astype(np.float64)
    mean: F64 = (last - (count - 1) / 2)[group]
    return mean


def _page(report: ParityReport) -> str:
    """Write the report as HTML with its pictures inside."""
    first = report.first_different
    verdict = (
        "<p class=good>Every stage agrees.</p>"
        if first is None
        else f"<p class=bad>First difference: {html.escape(first.sentence())}.</p>"
    )
    rows = "".join(
        f"<tr><td>{html.escape(k)}</td><td>{html.escape(v)}</td></tr>" for k, v in report.facts.items()
    )
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(report.title)}</title>"
        f"<style>{STYLE}</style><h1>{html.escape(report.title)}</h1>{verdict}"
        + (f"<table>{rows}</table>" if rows else "")
        + f"<h2>Stages</h2><table><tr><th>stage<th>shape<th>difference<th>allowed<th>result</tr>"
        f"{''.join(map(_row, report.results))}</table>"
        + "<p>A difference is the largest one, as a part of the stage's largest expected value. The order of the "
        "presses is compared by rank correlation.</p>" + "".join(_pictures(report)) + "</html>\n"
    )


def _row(result: Stage) -> str:
    shape = "x".join(map(str, result.expected.shape))
    number = html.escape(result.fault) if result.fault else f"{result.difference:.3g}"
    least = "at least " if result.kind == "order" else ""
    word, style = ("equal", "good") if result.is_equal else ("differs", "bad")
    return (
        f"<tr><td>{html.escape(result.name)}<td class=n>{shape}<td class=n>{number}"
        f"<td class=n>{least}{result.allowed:g}<td class={style}>{word}</tr>"
    )


def _pictures(report: ParityReport) -> Iterator[str]:
    frames = report.frames
    maps = next((stage for stage in report.results if stage.kind == "map"), None)
    if maps is None or maps.expected.shape != maps.found.shape or maps.expected.ndim != 3:
        return
    expected, bundle_maps = (np.asarray(one, np.float32) for one in (maps.expected, maps.found))
    low = float(np.nan_to_num(expected).min())
    span = max(float(np.nan_to_num(expected).max()) - low, 1e-30)
    yield "<h2>Score maps</h2><p>Both in one scale. The difference is shown a hundred times as strong.</p>"
    for number in range(min(len(expected), MOST_SHOWN)):
        if frames is not None and number < len(frames):
            yield _figure(frames[number], f"frame {number}")
        yield _figure(_map((expected[number] - low) / span), "research model")
        yield _figure(_map((bundle_maps[number] - low) / span), "bundle")
        yield _figure(_map(100 * np.abs(expected[number] - bundle_maps[number]) / span), "difference x 100")
        yield "<br>"


def _map(share: NDArray[np.floating]) -> U8:
    return paint_scores(np.asarray(np.clip(np.nan_to_num(share), 0, 1) * FULL_SCALE, np.float32))


def _figure(rgb: U8, caption: str) -> str:
    scale = min(1.0, MOST_SIDE / max(rgb.shape[:2]))
    size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA) if scale < 1 else rgb
    data = base64.b64encode(encode(np.asarray(small, np.uint8))).decode()
    return (
        f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
