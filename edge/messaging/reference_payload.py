"""A reference press: what it gave, and its control charts. Payload and message."""

from typing import ClassVar, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from edge.core.reference_press.charts import Chart, Judgement, Outcome
from edge.core.reference_press.control_chart import Signal
from edge.messaging.payload_base import Payload
from edge.messaging.result_payload import ResultPayload

__all__ = ["CHARTED", "ChartEntry", "ReferencePayload"]

# The newest values of each chart that a message has: enough to draw it, and 6 kB at most.
CHARTED: Final = 50


class ChartEntry(BaseModel):
    """One control chart of individual values."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    measure: str = Field(description="score, strength_levels, x_mm, y_mm, turn_deg or noise_levels")
    unit: str
    values: list[float] = Field(description=f"oldest first, the newest {CHARTED}")
    time_ns: list[int] = Field(description="of each value, wall clock, nanoseconds since 1970 UTC")
    low: float | None = Field(default=None, description="the lower limit; null while limits are learnt")
    centre: float | None = None
    high: float | None = None
    learnt: int = Field(ge=0, description="presses that the limits are made from so far")
    learn: int = Field(ge=2, description="presses that they are made from")
    signals: list[Signal] = Field(description="what the newest value says")

    @classmethod
    def of(cls, chart: Chart) -> Self:
        limits = chart.limits
        return cls(
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


class ReferencePayload(Payload):
    """A press of a master piece. It is no part's, and counts on the gel."""

    topic: ClassVar = "reference"
    kind: Literal["reference"] = "reference"
    is_replayed: bool = Field(default=False, description="sent late, from the outbox")
    press_id: str
    number: int = Field(ge=1, description="of the reference presses of this station's database")
    piece: str = Field(description="the master piece")
    part: str
    position: str | None = None
    outcome: Outcome = Field(
        description="learning: limits are not known yet; warning: a run rule; not_measured: rejected, or no score"
    )
    sentences: list[str] = Field(description="what was found, and what to do")
    verdict: str = Field(description="pass, fail, unsure, rejected or error")
    expected: str = Field(description="the verdict that this master piece must give")
    score: float | None = None
    threshold: float | None = None
    bundle_id: str
    sensor_serial: str
    gel_id: str
    gel_presses: int = Field(ge=0, description="presses of this gel, including this one")
    heatmap_topic: str | None = Field(
        default=None, description="where this press's picture is sent, below the root"
    )
    charts: list[ChartEntry]

    @classmethod
    def of(cls, result: ResultPayload, number: int, piece: str, expected: str, judgement: Judgement) -> Self:
        """Make the payload. result: as it would be published of a part."""
        names = ["time_ns", "press_id", "part", "position", "score", "threshold", "heatmap_topic"]
        names += ["sensor_serial", "gel_id", "gel_presses"]
        return cls(
            **{name: getattr(result, name) for name in names},
            number=number,
            piece=piece,
            outcome=judgement.outcome,
            sentences=list(judgement.sentences),
            verdict="error" if result.verdict is None else result.verdict.value,
            expected=expected,
            bundle_id=result.bundle_id or "",
            charts=list(map(ChartEntry.of, judgement.charts)),
        )
