"""Reference presses as text, CSV and JSON."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from edge.clock import local_time
from edge.core.printable import printable, score_texts
from edge.core.reference_press.charts import Chart, ReferencePress, charts, judge
from edge.core.reference_press.control_chart import MEASURES
from edge.messaging.payload_base import iso_time
from edge.messaging.result_payload import ChartEntry
from edge.store.reference_presses import PieceKey

__all__ = ["csv_text", "json_line", "nothing_text", "piece_text"]


def nothing_text(known: Sequence[PieceKey]) -> str:
    """Say that no press was chosen, and which pieces there are."""
    if not known:
        return "no reference press was made yet; ask for one with `gelgate station reference press`"
    return printable(f"no such master piece was pressed; there are {'; '.join(map(str, known))}")


def piece_text(key: PieceKey, presses: Sequence[ReferencePress], learn: int, count: int) -> str:
    """The limits of each measure, then the newest presses, oldest first."""
    lines = [f"master piece {key}: {len(presses)} presses", ""]
    lines += [_chart_line(chart) for chart in charts(presses, learn)]
    shown = range(max(0, len(presses) - count), len(presses))
    lines += ["", *(_press_line(presses[: number + 1], learn) for number in shown)]
    return "\n".join(map(printable, lines))


def json_line(key: PieceKey, presses: Sequence[ReferencePress], learn: int) -> str:
    """Write one object: the piece, its charts, what the newest press says, and the presses."""
    judgement = judge(presses, learn)
    return json.dumps(
        {
            **key._asdict(),
            "outcome": judgement.outcome,
            "sentences": judgement.sentences,
            "charts": [ChartEntry.of(chart).model_dump(mode="json") for chart in judgement.charts],
            "presses": [asdict(press) for press in presses],
        }
    )


def csv_text(chosen: Mapping[PieceKey, Sequence[ReferencePress]], learn: int) -> str:
    """Write one row for each press, with what it said when it was made. An empty cell is a missing value."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [measure.name for measure in MEASURES]
    origin = ["press_id", "gel_id", "bundle_id", "expected", "verdict"]
    writer.writerow(["time", *PieceKey._fields, *origin, "outcome", "threshold", *names, "sentences"])
    for key, presses in chosen.items():
        for number, press in enumerate(presses, start=1):
            judgement = judge(presses[:number], learn)
            values = [*(getattr(press, name) for name in origin), judgement.outcome.value, press.threshold]
            values += [press.value(measure) for measure in MEASURES]
            writer.writerow([iso_time(press.time_ns), *key, *values, "; ".join(judgement.sentences)])
    return out.getvalue()


def _chart_line(chart: Chart) -> str:
    name = f"{chart.measure.title} ({chart.measure.unit})" if chart.measure.unit else chart.measure.title
    limits = chart.limits
    if limits is None:
        return f"  {name:18} {chart.values[-1]:10.4g}  limits are learnt: {chart.learnt} of {chart.learn}"
    said = "  ".join(signal.value.replace("_", " ") for signal in chart.signals)
    return (
        f"  {name:18} {chart.values[-1]:10.4g}  limits {limits.low:.4g} to {limits.high:.4g}, centre "
        f"{limits.centre:.4g}  {said}"
    ).rstrip()


def _press_line(presses: Sequence[ReferencePress], learn: int) -> str:
    newest, judgement = presses[-1], judge(presses, learn)
    score = (
        ""
        if newest.score is None or newest.threshold is None
        else "  " + " / ".join(score_texts(newest.score, newest.threshold))
    )
    words = [f"{local_time(newest.time_ns)}  {newest.verdict}{score}  gel {newest.gel_id}"]
    words += [judgement.outcome.value.replace("_", " "), *judgement.sentences]
    return "  ".join(words)
