"""An evaluation as a table for people, as JSON for programs, and as a sheet of its worst and best score maps."""

import json
import statistics
from collections.abc import Sequence

import cv2
import numpy as np

from calibration.evaluate.scoring import Evaluation, ScoredPress
from calibration.metrics.summary import Measure
from edge.core.arrays import U8
from edge.model.comparison import outline_regions
from edge.pictures.image_file import encode
from edge.pictures.press_picture import PressCaption, draw_press

__all__ = ["as_json", "as_table", "draw_sheet"]

_SCHEMA_VERSION = 1
_COLUMNS, _HEADING, _PANEL = 4, 36, 384
_MASK_COLOUR, _PAPER, _INK = (255, 255, 255), 250, (25, 25, 25)


def as_table(evaluation: Evaluation) -> str:
    """The report as lines of text."""
    e, manifest = evaluation, evaluation.bundle.manifest
    good, bad = (sum(s.press.is_defective is kind for s in e.scored) for kind in (False, True))
    names = {s.press.specimen for s in e.scored}
    unsure = "; {} good and {} defective ones are unsure".format(*e.unsure) if any(e.unsure) else ""
    lines = [
        f"{manifest.part}/{manifest.position} by {manifest.method} ({manifest.mode or 'mode unknown'})",
        f"{good} good and {bad} defective presses, {'unknown' if None in names else len(names)} specimens",
    ]
    fitted = "no press left out: by folder and name none was in the fit"
    if e.left_out:
        fitted = f"{e.left_out} presses left out, because the bundle was fitted on presses of these names"
    lines.append(f"{fitted}; only names are compared, so a copy under another name counts as new")
    if e.seen_specimens:
        lines.append(
            f"{e.seen_specimens} specimens have other presses in the fit: the good scores are optimistic"
        )
    lines += e.remarks
    lines += ["", f"{'measure':<20}{'value':>9}   {'95 % over images':<20}{'95 % over specimens':<20}"]
    lines += [_row(m) for m in e.measures]
    lines += [
        "",
        f"at threshold {e.threshold:.6g}: {e.false_alarms} of {good} good presses fail, "
        f"{e.misses} of {bad} defective ones pass{unsure}",
        f"time per frame, median: trunk {_median(e, 'trunk_ms'):.1f} ms, head {_median(e, 'head_ms'):.1f} ms",
    ]
    lines += [f"no score: {press.path}: {reason}" for press, reason in e.unscorable]
    return "\n".join(lines)


def _row(one: Measure) -> str:
    if one.value is None:
        return f"{one.name:<20}{'-':>9}   {one.reason}"
    return f"{one.name:<20}{one.value:>9.4f}   {_span(one.over_images):<20}{_span(one.over_specimens):<20}".rstrip()


def _span(interval: tuple[float, float] | None) -> str:
    return f"{interval[0]:.4f} to {interval[1]:.4f}" if interval else "-"


def _median(evaluation: Evaluation, name: str) -> float:
    return float(statistics.median(getattr(s, name) for s in evaluation.scored))


def as_json(evaluation: Evaluation) -> str:
    """The report as JSON, every press with its score. Paths are relative to the dataset."""
    e, manifest = evaluation, evaluation.bundle.manifest
    presses = [
        {
            "file": s.press.path.relative_to(e.dataset.root).as_posix(),
            "part": s.press.part,
            "position": s.press.position,
            "specimen": s.press.specimen,
            "defect": s.press.defect,
            "defect_pixels": int(s.mask.sum()),
            "anomaly_score": s.anomaly_score,
            "map_max": float(s.score_map.max()),
        }
        for s in e.scored
    ]
    document = {
        "schema_version": _SCHEMA_VERSION,
        "bundle": {
            "digest": e.bundle.digest,
            "part": manifest.part,
            "position": manifest.position,
            "method": manifest.method,
            "mode": manifest.mode,
        },
        "dataset": {"layout": e.dataset.layout, "left_out": e.left_out, "seen_specimens": e.seen_specimens},
        "measures": {m.name: _measure(m) for m in e.measures},
        "bootstrap": {"replicates": e.replicates, "seed": e.seed, "confidence": 0.95},
        "threshold": {
            "value": e.threshold,
            "false_alarms": e.false_alarms,
            "misses": e.misses,
            "unsure": sum(e.unsure),
        },
        "milliseconds": {"trunk": _median(e, "trunk_ms"), "head": _median(e, "head_ms")},
        "presses": presses,
        "unscorable": [{"file": p.path.name, "reason": reason} for p, reason in e.unscorable],
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _measure(one: Measure) -> dict[str, object]:
    if one.value is None:
        return {"value": None, "reason": one.reason}
    return {"value": one.value, "over_images": one.over_images, "over_specimens": one.over_specimens}


def draw_sheet(evaluation: Evaluation) -> bytes:
    """PNG bytes: four rows of up to four presses, each as a station shows it, with the mask's outline, and
    those of drawn regions."""
    good = sorted((s for s in evaluation.scored if not s.press.is_defective), key=lambda s: -s.anomaly_score)
    bad = sorted((s for s in evaluation.scored if s.press.is_defective), key=lambda s: s.anomaly_score)
    rows = (
        ("worst: good presses with the highest scores", good[:_COLUMNS]),
        ("worst: defective presses with the lowest scores", bad[:_COLUMNS]),
        ("best: defective presses with the highest scores", bad[::-1][:_COLUMNS]),
        ("best: good presses with the lowest scores", good[::-1][:_COLUMNS]),
    )
    sheet = np.concatenate([_draw_row(title, presses, evaluation) for title, presses in rows if presses])
    return encode(sheet)


def _draw_row(title: str, presses: Sequence[ScoredPress], evaluation: Evaluation) -> U8:
    drawn = [_draw(press, evaluation) for press in presses]
    drawn += [np.full_like(drawn[0], _PAPER)] * (_COLUMNS - len(drawn))
    row = np.concatenate(drawn, axis=1)
    heading = np.full((_HEADING, row.shape[1], 3), _PAPER, np.uint8)
    cv2.putText(heading, title, (8, 26), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _INK, 1, cv2.LINE_AA)
    return np.concatenate([heading, row])


def _draw(one: ScoredPress, evaluation: Evaluation) -> U8:
    manifest, rgb = evaluation.bundle.manifest, one.press.rgb()
    frame = np.ascontiguousarray(evaluation.bundle.region.crop(rgb))
    outlines, _ = cv2.findContours(one.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(frame, outlines, -1, _MASK_COLOUR, 1)
    caption = PressCaption(
        press_id=one.press.path.stem,
        verdict=manifest.decide(one.anomaly_score).kind,
        score=one.anomaly_score,
        threshold=evaluation.threshold,
        mm_per_pixel=evaluation.bundle.profile.mm_per_pixel,
        station=one.press.defect or "good",
        part=f"{one.press.part}/{one.press.position}",
        time="",
        drawn=manifest.regions.describe() if manifest.regions else "",
    )
    regions = outline_regions(evaluation.bundle, one.pose)
    return draw_press(frame, one.score_map, caption, _PANEL, outlines=regions)
