"""An evaluation as a table for people and as JSON for programs."""

import json
import statistics

from calibration.evaluate.scoring import Evaluation
from calibration.metrics import Measure

__all__ = ["as_json", "as_table"]

_SCHEMA_VERSION = 1


def as_table(evaluation: Evaluation) -> str:
    """The report as lines of text."""
    e, manifest = evaluation, evaluation.bundle.manifest
    good, bad = (sum(s.press.is_defective is kind for s in e.scored) for kind in (False, True))
    lines = [
        f"{manifest.part}/{manifest.position} by {manifest.method} ({manifest.mode or 'mode unknown'})",
        f"{good} good and {bad} defective presses, {_specimens(e)} specimens",
    ]
    if e.left_out:
        lines.append(f"{e.left_out} presses left out, because the bundle was fitted on them")
    if e.seen_specimens:
        lines.append(
            f"{e.seen_specimens} specimens have other presses in the fit: the good scores are optimistic"
        )
    lines += ["", f"{'measure':<20}{'value':>9}   {'95 % over images':<20}{'95 % over specimens':<20}"]
    lines += [_row(m) for m in e.measures]
    lines += [
        "",
        f"at threshold {e.threshold:.6g}: {e.false_alarms} of {good} good presses fail, "
        f"{e.misses} of {bad} defective ones pass" + _unsure(e),
        f"time per frame, median: trunk {_median(e, 'trunk_ms'):.1f} ms, head {_median(e, 'head_ms'):.1f} ms",
    ]
    lines += [f"no score: {press.path}: {reason}" for press, reason in e.unscorable]
    return "\n".join(lines)


def _unsure(evaluation: Evaluation) -> str:
    good, bad = evaluation.unsure
    return f"; {good} good and {bad} defective ones are unsure" if good or bad else ""


def _row(one: Measure) -> str:
    if one.value is None:
        return f"{one.name:<20}{'-':>9}   {one.reason}"
    return f"{one.name:<20}{one.value:>9.4f}   {_span(one.over_images):<20}{_span(one.over_specimens):<20}".rstrip()


def _span(interval: tuple[float, float] | None) -> str:
    return f"{interval[0]:.4f} to {interval[1]:.4f}" if interval else "-"


def _median(evaluation: Evaluation, name: str) -> float:
    return float(statistics.median(getattr(s, name) for s in evaluation.scored))


def _specimens(evaluation: Evaluation) -> str:
    names = {s.press.specimen for s in evaluation.scored}
    return "unknown" if None in names else str(len(names))


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
