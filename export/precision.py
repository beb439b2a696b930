"""A bundle in another precision: measured on the part's nominal frames, chosen by measurement, written to its card.

float32, float16 storage, and int8. int8 is calibrated on nominal frames as the network sees them, also with a painted
square; layers that it harms most stay in float until the score maps agree within the limit. `auto` takes int8 only
where this machine computes it correctly (a probe for VNNI) and faster, float16 storage where the maps stay the same,
float32 otherwise.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from calibration.fitting.bundle_measurements import cost_card, measure_tolerance, score_again
from calibration.metrics.pixel import aupro
from calibration.progress import Report
from calibration.quantise import halved, layers, quantise_graph
from edge.core.arrays import F32, U8, Mask
from edge.core.errors import BundleMismatch, FitError
from edge.model.bundle import Bundle
from edge.model.bundle_writer import facts_of, rewrite_files
from edge.model.detectability import CARD
from edge.model.manifest import Manifest
from edge.model.manifest_facts import DAMAGE_FOUND
from edge.model.scorer import Scorer
from edge.model.session import saturates
from export.finish import paint_square
from export.parity import score_frames, show_frames

__all__ = ["Measured", "Precision", "Precisions", "choose_precision", "in_precision", "measure_precisions"]

Precision = Literal["float32", "float16", "int8"]

LIMIT = 0.05
"""Allowed difference of the score maps in int8: the norm of the difference over the norm of the float maps."""

STORAGE_LIMIT = 0.01
"""The same for weights that are only stored as float16."""

WORTH = 0.9
"""int8 must take less than this part of the float graph's time, and float16 of its bytes, to be worth it."""

CALIBRATION_FRAMES = 32
ALONE_FRAMES = 4
TIMED_RUNS = 15

# What a manifest says of the damage that its limit finds.
_OF_OLD_LIMIT: Final = (CARD, DAMAGE_FOUND)

Masked = tuple[Sequence[U8], Sequence[Mask]]
"""Frames with the masks of their defects, for AU-PRO."""


@dataclass(frozen=True)
class Measured:
    """One precision of the bundle's network."""

    precision: Precision
    graph: bytes
    map_difference: float
    """Relative norm over nominal frames."""
    score_difference: float
    """The largest, relative to the threshold."""
    rise: float
    """The largest by which a nominal score rises."""
    aupro_change: float | None
    """None without masks."""
    milliseconds: float
    """Median of the network and its head for a frame, on this machine."""
    bytes: int
    in_float: tuple[str, ...] = ()
    """Layers that stayed."""

    def card(self) -> dict[str, Any]:
        """Give the manifest everything but the graph."""
        values = {key: value for key, value in asdict(self).items() if key not in ("graph", "precision")}
        return {key: round(v, 6) if isinstance(v, float) else v for key, v in values.items()}


@dataclass(frozen=True)
class Precisions:
    """All precisions that were measured."""

    results: tuple[Measured, ...]
    is_int8_exact: bool
    """Whether int8 products do not saturate here (VNNI or similar)."""
    limit: float
    faults: tuple[str, ...] = ()
    """Why a precision is missing."""

    def of(self, precision: Precision) -> Measured:
        """Give a precision. Errors: FitError with the reason where it could not be made."""
        for result in self.results:
            if result.precision == precision:
                return result
        raise FitError(f"this bundle has no {precision}: {'; '.join(self.faults) or 'it was not measured'}")


def measure_precisions(
    bundle: Bundle,
    frames: U8,
    masked: Masked = ((), ()),
    *,
    limit: float = LIMIT,
    threads: int = 2,
    report: Report = lambda stage, fraction: None,
) -> Precisions:
    """Make and measure every precision. frames: nominal, uint8 (n, h, w, 3) of the bundle's region, at least four.

    Errors: BundleMismatch for a bundle without its trunk, or already in int8; FitError for too few frames.
    """
    network = _network(bundle)
    if len(frames) < ALONE_FRAMES:
        raise FitError(f"{len(frames)} nominal frames cannot calibrate int8; give at least {ALONE_FRAMES}")
    comparison = _Comparison(bundle, frames, masked, threads)
    results, faults = [comparison.of("float32", network)], []
    results.append(comparison.of("float16", halved(network)))
    report("int8", 0.0)
    try:
        results.append(_int8(network, comparison, limit, report))
    except Exception as error:  # noqa: BLE001 (the quantiser raises anything on operators that it does not know)
        faults.append(f"onnxruntime cannot quantise it ({str(error).strip()[:150] or type(error).__name__})")
    return Precisions(tuple(results), not saturates(), limit, tuple(faults))


def choose_precision(precisions: Precisions) -> Measured:
    """Choose the precision for this machine.

    int8 if it is exact, within the limit and faster; float16 storage if the maps stay the same; else float32.
    """
    plain, half = precisions.of("float32"), precisions.of("float16")
    whole = next((each for each in precisions.results if each.precision == "int8"), None)
    if (
        whole is not None
        and precisions.is_int8_exact
        and whole.map_difference <= precisions.limit
        and whole.milliseconds < WORTH * plain.milliseconds
    ):
        return whole
    is_smaller = half.bytes < WORTH * plain.bytes  # not where the weights are stored as float16 already
    return half if half.map_difference <= STORAGE_LIMIT and is_smaller else plain


def in_precision(
    bundle: Bundle, precisions: Precisions, choice: Measured, frames: U8, threads: int = 2
) -> tuple[Manifest, dict[str, bytes]]:
    """The bundle with this network: its golden frames, tolerance, costs and card are measured again.

    The threshold rises by the largest rise of a nominal score, so nominal presses fail no more often than before. What
    damage the old one finds is then said no more. Errors: FitError where the score maps differ by more than the limit.
    """
    allowed = precisions.limit if choice.precision == "int8" else STORAGE_LIMIT
    if choice.map_difference > allowed:
        raise FitError(
            f"in {choice.precision} the score maps differ by {choice.map_difference:.3g}, {allowed:g} is allowed; keep "
            "float32, or raise --limit and evaluate the bundle on damaged presses"
        )
    network = _with_network(bundle, choice.graph)
    manifest = bundle.manifest
    threshold, kept = manifest.threshold, dict(manifest.facts)
    if choice.rise > 0:
        kept = {name: fact for name, fact in kept.items() if name not in _OF_OLD_LIMIT}
        words = f"{threshold.method}, raised by {choice.rise:.3g} for {choice.precision}"
        threshold = threshold.model_copy(update={"value": threshold.value + choice.rise, "method": words})
    card: dict[str, Any] = {
        "chosen": choice.precision,
        "int8_exact_here": precisions.is_int8_exact,
        **{each.precision: each.card() for each in precisions.results},
    }
    changed = {"threshold": threshold, "facts": {**kept, "precision": card}}
    facts = facts_of(manifest).model_copy(update=changed)
    scorer = Scorer(Bundle.in_memory(*rewrite_files(bundle, facts, (), **network), bundle.where), threads)
    golden = [score_again(frame, scorer) for frame in bundle.golden]
    measured_facts = {
        "tolerance": measure_tolerance(scorer, golden, threads) if golden else facts.tolerance,
        "cost": cost_card(scorer, frames, threads, {}),
    }
    return rewrite_files(bundle, facts.model_copy(update=measured_facts), golden, **network)


def _int8(network: bytes, comparison: "_Comparison", limit: float, report: Report) -> Measured:
    """int8, with as many of the most sensitive layers in float as the limit needs."""
    some = comparison.show(CALIBRATION_FRAMES)
    # Ranges of nominal frames alone would cut what damage shows: each is also given with a painted square.
    both = np.concatenate([some, [paint_square(frame) for frame in some]])
    best = comparison.of("int8", quantise_graph(network, both))
    if best.map_difference <= limit:
        return best
    names, alone = layers(network), []
    for number, name in enumerate(names):
        graph = quantise_graph(network, both[:ALONE_FRAMES], only=[name])
        alone.append(comparison.map_difference(graph, ALONE_FRAMES))
        report("int8", (number + 1) / len(names))
    worst_first = [names[k] for k in np.argsort(alone)[::-1]]
    count = 1
    while best.map_difference > limit and count < len(names):
        kept = worst_first[:count]
        trial = comparison.of("int8", quantise_graph(network, both, in_float=kept), kept)
        best = trial if trial.map_difference < best.map_difference else best
        count *= 2
    return best


class _Comparison:
    """Maps and scores of the bundle as it is, with which its other precisions are compared."""

    def __init__(self, bundle: Bundle, frames: U8, masked: Masked, threads: int) -> None:
        self._bundle, self._frames, self._masked, self._threads = bundle, frames, masked, threads
        self._plain = Scorer(bundle, threads, is_skipping=False)
        self._maps, self._scores = score_frames(self._plain, frames)
        self._aupro = self._aupro_of(self._plain)
        self._milliseconds: float | None = None

    def of(self, precision: Precision, graph: bytes, in_float: Sequence[str] = ()) -> Measured:
        scorer = self._scorer(graph)
        maps, scores = score_frames(scorer, self._frames)
        aupro = self._aupro_of(scorer)
        scale = abs(self._bundle.manifest.threshold.value) or float(np.abs(self._scores).max()) or 1.0
        return Measured(
            precision=precision,
            graph=graph,
            map_difference=_relative(maps, self._maps),
            score_difference=float(np.abs(scores - self._scores).max()) / scale,
            rise=max(0.0, float((scores - self._scores).max())) if precision != "float32" else 0.0,
            aupro_change=None if aupro is None or self._aupro is None else aupro - self._aupro,
            milliseconds=self._time(scorer),
            bytes=len(graph),
            in_float=tuple(in_float),
        )

    def show(self, most: int) -> U8:
        """Return up to so many of the frames, evenly spread, as the network sees them."""
        return show_frames(self._plain, self._frames[:: max(1, len(self._frames) // most)][:most])

    def map_difference(self, graph: bytes, count: int) -> float:
        """Compare the first frames alone."""
        maps, _ = score_frames(self._scorer(graph), self._frames[:count])
        return _relative(maps, self._maps[:count])

    def _scorer(self, graph: bytes) -> Scorer:
        bundle = self._bundle
        files = rewrite_files(bundle, facts_of(bundle.manifest), (), **_with_network(bundle, graph))
        return Scorer(Bundle.in_memory(*files, bundle.where), self._threads, is_skipping=False)

    def _aupro_of(self, scorer: Scorer) -> float | None:
        frames, masks = self._masked
        return aupro(list(score_frames(scorer, frames)[0]), list(masks)) if len(frames) else None

    def _time(self, scorer: Scorer) -> float:
        """Milliseconds of a frame: those of the unchanged bundle, times the median ratio of neighbouring runs, so that
        the load of the machine falls on both."""
        ratios, plain = [], []
        for k in range(TIMED_RUNS):
            frame = self._frames[k % len(self._frames)]
            plain.append(_seconds(self._plain, frame))
            ratios.append(_seconds(scorer, frame) / plain[-1])
        if self._milliseconds is None:
            self._milliseconds = 1e3 * float(np.median(plain))
        return self._milliseconds * float(np.median(ratios))


def _seconds(scorer: Scorer, frame: U8) -> float:
    start = time.perf_counter()
    scorer.score(frame)
    return time.perf_counter() - start


def _relative(found: F32, expected: F32) -> float:
    norm = float(np.linalg.norm(expected.astype(np.float64)))
    return float(np.linalg.norm(found.astype(np.float64) - expected)) / max(norm, 1e-30)


def _network(bundle: Bundle) -> bytes:
    """The graph that is quantised: the trunk, or the single graph. Errors: BundleMismatch."""
    graph = bundle.graphs.trunk if bundle.manifest.backbone else bundle.graphs.detector
    if graph is None:
        raise BundleMismatch(f"bundle {bundle.where} has no trunk in memory; load it with its trunk")
    if b"QuantizeLinear" in graph:
        raise BundleMismatch(f"bundle {bundle.where} is quantised already; start from the float bundle")
    return graph


def _with_network(bundle: Bundle, graph: bytes) -> dict[str, Any]:
    """Return what a bundle with another network changes; it holds that network itself."""
    changed = {"trunk" if bundle.manifest.backbone else "detector": graph}
    return {"graphs": replace(bundle.graphs, **changed), "with_trunk": True}
