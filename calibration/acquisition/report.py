"""What an acquisition says: a line for each press, the forecast after each round, and the end."""

import cv2
import numpy as np

from calibration.acquisition.coverage import EARLIEST, LEAST, PAYS, ROUND, Coverage, Standing
from edge.core.arrays import U8
from edge.core.binomial import trials_needed
from edge.core.printable import write_most
from edge.pictures.heatmap import paint_scores
from edge.pictures.image_file import encode

__all__ = ["coverage_png", "forecast_lines", "press_line", "promise_line", "signals", "summary_lines"]

# The next promises that are worth naming, one after the other.
_RATES = (0.2, 0.1, 0.05, 0.02, 0.01)
# In the picture of the coverage a cell that is new on every second press has the brightest colour.
_BRIGHT = 4.0


def press_line(standing: Standing, piece: int | None) -> str:
    """Write one press: its piece, what is new on it, what is unseen, and what is promised."""
    of = "" if piece is None else f"  piece {piece}"
    seen = standing.coverage
    covered = "coverage unknown yet"
    if seen is not None:
        covered = f"new on it {100 * seen.newest:2.0f} %  unseen {100 * seen.unseen:2.0f} %"
    return f"press {standing.presses:3}{of}  {covered}  at most {_promised(standing)}"


def promise_line(standing: Standing) -> str:
    """Say what is promised by press and by piece, and what the next smaller rate needs."""
    sure = f"{100 * standing.confidence:g} % sure"
    counted = f"{standing.presses} presses"
    if _is_by_piece(standing):
        counted += f" of {standing.pieces} piece{'s' * (standing.pieces != 1)}"
    smaller = next((rate for rate in _RATES if rate < standing.rate(standing.presses) - 1e-9), None)
    more = ""
    if smaller is not None:
        needed = trials_needed(smaller, 0, standing.confidence) - standing.presses
        more = f"; {needed} more give {_percent(smaller)}" + " by press" * _is_by_piece(standing)
    return f"{counted}: at most {_promised(standing)}, {sure}{more}"


def _promised(standing: Standing) -> str:
    by_press = f"{write_most(standing.rate(standing.presses))} false alarms"
    if not _is_by_piece(standing):
        return by_press
    if standing.by_piece is None:
        return f"{by_press} by press, nothing promised of other pieces"
    return f"{by_press} by press, {write_most(standing.by_piece)} by piece"


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"


def _is_by_piece(standing: Standing) -> bool:
    return standing.pieces == 1 or standing.pieces not in (None, standing.presses)


def forecast_lines(standing: Standing, gel_limit: int) -> list[str]:
    """Say how many more presses, for which reason, and what they cost of a gel of that many presses."""
    if standing.still_needed is None or standing.covered_at is None:
        what = "presses" if standing.pieces is None else "pieces"
        return [f"forecast: none before there are {LEAST} {what}"]
    if standing.is_enough:
        return []
    for_promise = max(standing.promised_at - standing.presses, 0)
    for_coverage = max(standing.covered_at - standing.presses, 0)
    gel = standing.still_needed / gel_limit
    return [
        f"forecast: {standing.still_needed} more presses, {standing.presses + standing.still_needed} in all "
        f"({for_promise} for the promise of {_percent(standing.promise)}, about {for_coverage} for the coverage); "
        f"{_percent(gel)} of a gel rated for {gel_limit} presses"
    ]


def summary_lines(standing: Standing, gel_limit: int) -> list[str]:
    """The end: promise, coverage by place, and whether more presses pay."""
    lines = [promise_line(standing)]
    seen = standing.coverage
    if seen is None:
        lines.append(_why_unknown(standing))
    else:
        lines.append(
            f"unseen: {_percent(seen.unseen)} of the touched cells would be new on a new piece; {_worst(seen)}"
        )
    lines.append(_verdict(standing))
    return lines + forecast_lines(standing, gel_limit) * (not standing.is_enough)


def _why_unknown(standing: Standing) -> str:
    pieces = "pieces unknown" if standing.pieces is None else f"{standing.pieces} piece"
    pieces += "s" * (standing.pieces is not None and standing.pieces != 1)
    return (
        f"coverage unknown: {standing.presses} presses, {pieces}; what a new piece would show is not known from fewer "
        f"than {LEAST} pieces: press other pieces"
    )


def _verdict(standing: Standing) -> str:
    if standing.is_enough:
        return (
            f"enough: the promise is reached, and {ROUND} more presses would lower the unseen share by "
            f"{_percent(PAYS)} at most"
        )
    missing = [] if standing.is_promised else ["the promise is not reached"]
    if not standing.is_covered:
        fall = standing.fall
        missing.append(
            f"the coverage is not known before {EARLIEST} presses of {LEAST} pieces"
            if fall is None
            else f"{ROUND} more presses would lower the unseen share by {_percent(fall)}"
        )
    return f"not enough: {' and '.join(missing)}"


def _worst(coverage: Coverage) -> str:
    """Say where most is new, in words: of nine fields of the region the one with the largest mean."""
    fields = [
        (float(np.nanmean(field)), f"{down} {across}".strip())
        for rows, down in zip(np.array_split(coverage.by_place, 3), ("upper", "middle", "lower"), strict=True)
        for field, across in zip(np.array_split(rows, 3, axis=1), ("left", "centre", "right"), strict=True)
        if np.isfinite(field).any()
    ]
    share, where = max(fields)
    return f"most at the {where}, {_percent(share)}"


def signals(standing: Standing, file: str, source: str, piece: str | None) -> dict[str, object]:
    """Return the same for a program: one line of signals.jsonl. piece: the source's own name of it."""
    seen = standing.coverage
    return {
        "file": file,
        "source": source,
        "piece": piece,
        "presses": standing.presses,
        "pieces": standing.pieces,
        "by_press": standing.rate(standing.presses),
        "by_piece": standing.by_piece,
        "confidence": standing.confidence,
        "unseen": None if seen is None else seen.unseen,
        "new": None if seen is None else seen.newest,
        "fall": standing.fall,
        "still_needed": standing.still_needed,
        "is_enough": standing.is_enough,
    }


def coverage_png(coverage: Coverage, rgb: U8) -> bytes:
    """The share of presses that show something new, by place, over a press of the region, uint8 (h, w, 3).

    0 is black, half and more is pale yellow; grey is not touched.
    """
    h, w = rgb.shape[:2]
    shares = coverage.by_place
    colours = paint_scores(np.nan_to_num(_BRIGHT * shares).astype(np.float32))
    colours[np.isnan(shares)] = 128
    large = cv2.resize(colours, (w, h), interpolation=cv2.INTER_NEAREST)
    text = {
        "gelgate": f"unseen {coverage.unseen:.4f}, {len(coverage.neighbours)} presses of {coverage.pieces} pieces"
    }
    return encode(np.concatenate([np.asarray(large, np.uint8), rgb], axis=1), text)
