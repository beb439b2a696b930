"""The measurements on a bundle before it is written: golden frames, tolerance, costs, where presses touch."""

import contextlib
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import onnxruntime as ort

from calibration.fitting.limits.threshold import FEWEST_PIECES, count_needed, pieces_of
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.presses.strangers import find_copies
from edge.core.arrays import F64, U8
from edge.core.detector import Bank, Detector, KeepsMean
from edge.core.errors import FitError, NotScorable
from edge.core.imaging.quality import NominalContact, NominalStrength
from edge.core.printable import write_count
from edge.extras import find_version
from edge.model.bundle import GoldenFrame
from edge.model.manifest import CostCard, Provenance, ThresholdEntry, ToleranceEntry
from edge.model.manifest_facts import GIVEN, UNPROVEN
from edge.model.packing import pack
from edge.model.scorer import Scorer, map_peaks
from edge.pictures.nominal_pictures import NominalPictures

__all__ = [
    "check_given",
    "contact_range",
    "cost_card",
    "count_stored",
    "golden_frames",
    "measure_tolerance",
    "picture_presses",
    "placeholders",
    "provenance",
    "rate_warnings",
    "score_again",
    "state_threshold",
    "strength_range",
    "warnings",
]

TOLERANCE_FACTOR = 8.0
"""The tolerance is this many times the largest difference seen over runs, threads and batch sizes."""

TOLERANCE_RELATIVE = 1e-3
"""Room for other processors, which sum in another order: float32 features through some thousand additions and a
square root agree to about 1e-5; ten times that and a margin. Measured on x86 alone."""

CONTACT_MARGIN = 0.05
"""How far beyond the nominal presses one may lie, as a fraction of the picture, or half their spread if more."""

LEAST_AREA_SHARE = 0.5
"""Of the smallest nominal contact: the lowest area that is inspected. A choice, so that the range is not open below."""

PAINTED_LEVEL = 40


def golden_frames(scorer: Scorer, frames: U8, scores: F64 | None = None) -> list[GoldenFrame]:
    """The nominal frames of middle and highest score, and a painted one, so that a high score is checked as well.

    frames: uint8 (n, h, w, 3), in the bank's pose. scores: of the nominal presses, (n,); None where none are known.
    Errors: NotScorable.
    """
    if scores is None:
        scores = np.array([scorer.score_in_pose(frame).anomaly_score for frame in frames])
    order = np.argsort(scores, kind="stable")
    middle = frames[order[len(order) // 2]]
    chosen = {
        "middle nominal score": middle,
        "highest nominal score": frames[order[-1]],
        "middle nominal press with a painted square": _paint(middle),
    }
    scored = {what: scorer.score_in_pose(rgb) for what, rgb in chosen.items()}
    return [
        GoldenFrame(rgb, what, scored[what].anomaly_score, map_peaks(scored[what].score_map))
        for what, rgb in chosen.items()
    ]


def _paint(rgb: U8) -> U8:
    """The frame with a dark square of an eighth of its side in the middle."""
    h, w = rgb.shape[:2]
    painted, half = rgb.copy(), max(1, min(h, w) // 16)
    painted[h // 2 - half : h // 2 + half, w // 2 - half : w // 2 + half] = PAINTED_LEVEL
    return painted


def score_again(frame: GoldenFrame, scorer: Scorer) -> GoldenFrame:
    """Return a golden frame with the score and map that this scorer gives it."""
    scored = scorer.score_in_pose(frame.rgb)
    return replace(frame, score=scored.anomaly_score, map_peaks=map_peaks(scored.score_map))


def measure_tolerance(scorer: Scorer, golden: Sequence[GoldenFrame], threads: int) -> ToleranceEntry:
    """The change of the golden frames' scores between runs, one or two threads, and another batch size."""
    frames = np.stack([frame.rgb for frame in golden])
    runs = [[scorer.score_in_pose(frame) for frame in frames] for _ in range(2)]
    with contextlib.suppress(NotScorable):  # a graph of another author may take one frame at a time
        runs.append(scorer.score_batch(frames))
    for count in {1, 2} - {threads}:
        other = Scorer(scorer.bundle, count)
        runs.append([other.score_in_pose(frame) for frame in frames])
    scores = np.array([[s.anomaly_score for s in run] for run in runs])
    maps = np.stack([np.stack([s.score_map for s in run]) for run in runs]).astype(np.float64)
    score, score_map = np.ptp(scores, axis=0).max(), np.ptp(maps, axis=0).max()
    return ToleranceEntry(
        score=float(TOLERANCE_FACTOR * score),
        score_map=float(TOLERANCE_FACTOR * score_map),
        relative=TOLERANCE_RELATIVE,
        measured=float(max(score, score_map)),
    )


def cost_card(scorer: Scorer, frames: U8, threads: int, seconds: Mapping[str, float]) -> CostCard:
    """Medians over nine frames. seconds: of the stages `features`, `fit` and `threshold`, where they took place."""
    runs = [scorer.score_in_pose(frames[k % len(frames)]) for k in range(9)]
    entries = scorer.bundle.manifest.bank.values()
    return CostCard(
        trunk_ms=float(np.median([run.trunk_ms for run in runs])),
        head_ms=float(np.median([run.head_ms for run in runs])),
        threads=threads,
        features_s=seconds.get("features", 0.0),
        fit_s=seconds.get("fit", 0.0),
        threshold_s=seconds.get("threshold", 0.0),
        bank_bytes_stored=sum(entry.bytes_stored for entry in entries),
        bank_bytes_unpacked=sum(entry.bytes_unpacked for entry in entries),
    )


def count_stored(bank: Bank) -> int:
    """Return the bytes of a bank as stored. Errors: FitError where an array cannot be stored."""
    try:
        packs = [pack(array, bank.packing.get(name, "none")) for name, array in bank.arrays.items()]
    except ValueError as error:
        raise FitError(f"the bank cannot be stored: {error}") from error
    return sum(one.data.nbytes + (0 if one.scale is None else one.scale.nbytes) for one in packs)


def contact_range(presses: NominalPresses) -> NominalContact | None:
    """The spans of centroid and area with a margin, None where no touch was seen.

    A smaller contact than half of the smallest nominal one is of another object, or of a part that is partly pressed:
    the area is never open below.
    """
    if not presses.touches or presses.estimated:
        return None

    def around(values: list[float]) -> tuple[float, float]:
        low, high = min(values), max(values)
        margin = max(CONTACT_MARGIN, (high - low) / 2)
        return max(0.0, low - margin), min(1.0, high + margin)

    touches = presses.touches
    smallest = min(t.area for t in touches)
    low, high = around([t.area for t in touches])
    return NominalContact(
        x=around([t.x for t in touches]),
        y=around([t.y for t in touches]),
        area=(max(low, LEAST_AREA_SHARE * smallest), high),
    )


def strength_range(presses: NominalPresses) -> NominalStrength | None:
    """The lowest, middle and highest strength; None where it is not known, or an imprint has none."""
    if not presses.strengths or min(presses.strengths) <= 0:
        return None
    return NominalStrength(*(float(np.quantile(presses.strengths, rank)) for rank in (0, 0.5, 1)))


def warnings(presses: NominalPresses, frame: tuple[int, int], alpha: float | None) -> list[str]:
    """Warnings about these presses. alpha: None where no threshold is found.

    Errors: FitError for no presses, for copies of one picture, or for frames that are not (h, w).
    """
    n = len(presses)
    if n == 0:
        raise FitError(
            f"no nominal press was given; give at least {MIN_PRESSES}, or 1 with a picture of the free gel"
        )
    if presses.frames.shape[1:3] != frame:
        raise FitError(
            f"presses are {presses.frames.shape[1:3]}, the region is {frame} (h, w); read them again"
        )
    sentences = [*presses.faults, *find_copies(presses.names, list(presses.frames))]
    if alpha is not None and n > 1 and len({rgb.tobytes() for rgb in presses.frames}) == 1:
        raise FitError(
            f"all {n} presses are one picture: they do not show how sound presses differ, so there is no threshold; "
            "give different presses, or state a threshold yourself"
        )
    return sentences


def rate_warnings(specimens: Sequence[str | None], alpha: float | None) -> list[str]:
    """Warn where pieces are too few for a rate. alpha: None where none is promised."""
    n, pieces = len(specimens), len(set(pieces_of(specimens)))
    if alpha is None or pieces >= (fewest := max(count_needed(alpha), FEWEST_PIECES)):
        return []
    counted = write_count(n, "press") + ("" if pieces == n else f" of {write_count(pieces, 'piece')}")
    needed = f"{fewest} {'presses' if pieces == n else 'pieces'} are needed for {alpha:g}"
    if pieces < FEWEST_PIECES:
        of_others = "no false-alarm rate of other pieces, whose sound presses may all fail"
        return [f"{UNPROVEN}{counted} promise{'s' if n == 1 else ''} {of_others}; {needed}"]
    return [f"{counted} promise a false-alarm rate of 1/{pieces + 1} at best; {needed}"]


def picture_presses(presses: NominalPresses, detector: Detector) -> NominalPictures:
    """Make the small pictures that people are shown beside a press."""
    is_mean = isinstance(detector, KeepsMean) and detector.keeps_mean
    return NominalPictures.of(presses.frames, presses.names, is_mean=is_mean)


def check_given(threshold: float | None) -> None:
    """Check a threshold that was given. Errors: FitError for one that is not finite."""
    if threshold is not None and not math.isfinite(threshold):
        raise FitError(f"a threshold is a finite number, found {threshold}")


def state_threshold(value: float, alpha: float) -> ThresholdEntry:
    """A threshold given by the user; it promises no rate."""
    return ThresholdEntry(value=value, method=GIVEN, alpha=alpha, alpha_floor=1.0, nominal_scores=())


def placeholders() -> tuple[ThresholdEntry, ToleranceEntry]:
    """Return what a bundle has that is only measured: with this threshold every press fails."""
    return state_threshold(0.0, 0.5), ToleranceEntry(score=0.0, score_map=0.0, relative=0.0, measured=0.0)


def provenance(created: str, presses: NominalPresses, seed: int | None, said: Sequence[str]) -> Provenance:
    """Record where the bundle comes from. said: the warnings."""
    return Provenance(
        created=created,
        presses=presses.names,
        left_out=presses.left_out,
        seed=seed,
        versions={
            "gelgate": find_version("gelgate"),
            "numpy": np.__version__,
            "onnxruntime": ort.__version__,
            "python": platform.python_version(),
        },
        warnings=tuple(said),
    )
