"""The message of a reference press, from what its charts say."""

from edge.core.reference_press.charts import Chart, Judgement
from edge.messaging.result_payload import CHARTED, ChartEntry, ReferencePayload, ResultPayload

__all__ = ["describe_chart", "describe_reference_press"]


def describe_chart(chart: Chart) -> ChartEntry:
    """Describe the newest values of a chart, with its limits."""
    limits = chart.limits
    return ChartEntry(
        measure=chart.measure.name,
        unit=chart.measure.unit,
        values=[float(f"{value:.6g}") for value in chart.values[-CHARTED:]],
        time_ns=[press.time_ns for press in chart.presses[-CHARTED:]],
        low=None if limits is None else limits.low,
        centre=None if limits is None else limits.centre,
        high=None if limits is None else limits.high,
        learnt=chart.learnt,
        learn=chart.learn,
        signals=list(chart.signals),
    )


def describe_reference_press(
    result: ResultPayload, number: int, piece: str, expected: str, judgement: Judgement
) -> ReferencePayload:
    """Describe a reference press. result: as it would be published of a part."""
    names = ["time_ns", "press_id", "part", "position", "score", "threshold", "heatmap_topic"]
    names += ["sensor_serial", "gel_id", "gel_presses"]
    return ReferencePayload(
        **{name: getattr(result, name) for name in names},
        number=number,
        piece=piece,
        outcome=judgement.outcome,
        sentences=list(judgement.sentences),
        verdict="error" if result.verdict is None else result.verdict.value,
        expected=expected,
        bundle_id=result.bundle_id or "",
        charts=list(map(describe_chart, judgement.charts)),
    )
