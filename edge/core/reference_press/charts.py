"""The charts of one master piece at one position of a part: limits, signals, and what the newest press says.

The first `learn` presses of a chart that gave the expected verdict make its limits; later ones are compared with them,
and never move them. Score belongs to a bundle and a gel, strength and noise to a gel, the place to neither: after a
change of gel the place is still compared, with the limits from before.
"""

import datetime
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from edge.core.reference_press.control_chart import MEASURES, Limits, signals
from edge.core.reference_press.outcome import Imprint, Measure, Outcome, Signal
from edge.core.sentence import Sentence

__all__ = ["Chart", "Judgement", "ReferencePress", "charts", "judge", "newest_begin", "why_due"]

# Verdicts with a score.
_SCORED: Final = ("pass", "fail", "unsure")


@dataclass(frozen=True)
class ReferencePress:
    """One press of a master piece."""

    press_id: str
    time_ns: int
    gel_id: str
    bundle_id: str
    expected: str
    """The verdict that it must give."""
    verdict: str
    """Pass, fail, unsure, rejected or error."""
    score: float | None = None
    threshold: float | None = None
    imprint: Imprint = field(default_factory=Imprint)
    reason: str | None = None
    """Why it was rejected or is an error."""
    is_start: bool = False
    """The charts begin again with it."""

    @property
    def is_as_expected(self) -> bool:
        return self.verdict == self.expected

    @property
    def is_scored(self) -> bool:
        return self.verdict in _SCORED

    def value(self, measure: Measure) -> float | None:
        """Read a measure of the press; None where it was not measured."""
        if not self.is_scored:
            return None
        value = self.score if measure.name == "score" else getattr(self.imprint, measure.name)
        return None if value is None else float(value)


@dataclass(frozen=True)
class Chart:
    """One measure over the presses of its scope, oldest first."""

    measure: Measure
    presses: tuple[ReferencePress, ...]
    """The presses that have the measure."""
    values: tuple[float, ...]
    learnt: int
    learn: int
    limits: Limits | None
    """None while they are learnt, from `learnt` of `learn` presses."""
    signals: tuple[Signal, ...]
    """The signals of the last press."""


@dataclass(frozen=True)
class Judgement:
    """What the newest press says."""

    outcome: Outcome
    sentences: tuple[str, ...]
    """Each thing that was found, with what to do; for people."""
    charts: tuple[Chart, ...]


def charts(presses: Sequence[ReferencePress], learn: int) -> tuple[Chart, ...]:
    """Every chart that has a value. presses: of one master piece at one position and sensor, oldest first. learn: the
    number of presses that the limits are made from, at least 2."""
    made = (_chart(measure, presses, learn) for measure in MEASURES)
    return tuple(chart for chart in made if chart.presses)


def judge(presses: Sequence[ReferencePress], learn: int) -> Judgement:
    """The newest, last press against the others. Errors: ValueError for none."""
    if not presses:
        raise ValueError("a judgement needs a press")
    newest, drawn = presses[-1], charts(presses, learn)
    if not newest.is_scored:
        return Judgement(
            Outcome.NOT_MEASURED,
            (Sentence(f"{newest.reason or newest.verdict}; press the piece again"),),
            drawn,
        )
    concerned = [chart for chart in drawn if chart.presses[-1] is newest]
    beyond = _sentences(concerned, beyond=True)
    if not newest.is_as_expected:
        wrong = Sentence(f"its verdict is {newest.verdict}, this master piece must give {newest.expected}")
        beyond.insert(0, Sentence(f"{wrong}; check the piece, the gel and the selected part"))
    runs = _sentences(concerned, beyond=False)
    change = _changes(presses)
    if beyond:
        return Judgement(Outcome.OUT_OF_LIMITS, (*beyond, *runs, *change), drawn)
    if runs:
        return Judgement(Outcome.WARNING, (*runs, *change), drawn)
    waiting = [chart for chart in concerned if chart.limits is None]
    if waiting:
        learning = Sentence(f"limits are learnt: {min(c.learnt for c in waiting)} of {learn} presses")
        return Judgement(Outcome.LEARNING, (learning, *change), drawn)
    return Judgement(Outcome.IN_LIMITS, change, drawn)


def _chart(measure: Measure, presses: Sequence[ReferencePress], learn: int) -> Chart:
    found = [(one, one.value(measure)) for one in _in_scope(measure, presses)]
    measured = _without_turns([(one, value) for one, value in found if value is not None], measure.unit)
    base = [(one, value) for one, value in measured if one.is_as_expected][:learn]
    limits = None
    if len(base) == learn:
        centre = sum(value for _, value in base) / learn
        limits = Limits.of(
            [value for _, value in base], max(measure.floor, measure.relative_floor * abs(centre))
        )
    values = tuple(value for _, value in measured)
    # The presses that made the limits are not compared with them.
    is_later = limits is not None and base[-1][0] is not measured[-1][0]
    return Chart(
        measure,
        tuple(one for one, _ in measured),
        values,
        len(base),
        learn,
        limits,
        signals(values, limits) if limits is not None and is_later else (),
    )


def _without_turns(
    measured: list[tuple[ReferencePress, float]], unit: str
) -> list[tuple[ReferencePress, float]]:
    """Angles without whole turns, so that -179 degrees are next to 179: as near to the first one as they can be."""
    if unit != "deg" or not measured:
        return measured
    first = measured[0][1]
    return [(one, value + 360 * round((first - value) / 360)) for one, value in measured]


def _in_scope(measure: Measure, presses: Sequence[ReferencePress]) -> list[ReferencePress]:
    """Select presses since the charts began, of the newest gel and bundle as far as the measure depends on them."""
    begun = max((number for number, press in enumerate(presses) if press.is_start), default=0)
    kept = list(presses[begun:])
    if not kept or measure.scope == "place":
        return kept
    newest = kept[-1]
    kept = [press for press in kept if press.gel_id == newest.gel_id]
    return (
        kept if measure.scope == "gel" else [press for press in kept if press.bundle_id == newest.bundle_id]
    )


_RUNS: Final = {
    Signal.TWO_OF_THREE: Sentence("two of the last three are beyond two standard deviations on one side"),
    Signal.RUN_OF_EIGHT: Sentence("the last eight are on one side of the centre: it has shifted"),
}


def _sentences(found: Iterable[Chart], *, beyond: bool) -> list[str]:
    """Write sentences of the charts with a value beyond a limit, or of those with a run alone."""
    return [
        f"{_sentence(chart, beyond=beyond)}; {chart.measure.what_to_do}"
        for chart in found
        if chart.signals and (Signal.BEYOND_LIMIT in chart.signals) == beyond
    ]


def _sentence(chart: Chart, *, beyond: bool) -> str:
    measure, limits = chart.measure, chart.limits
    unit = f" {measure.unit}" if measure.unit else ""
    if beyond and limits is not None:
        return Sentence(
            f"{measure.title} is {chart.values[-1]:.4g}{unit}, the limits are {limits.low:.4g} to "
            f"{limits.high:.4g}{unit}"
        )
    return f"{measure.title}: {'; '.join(_RUNS[signal] for signal in chart.signals)}"


def _changes(presses: Sequence[ReferencePress]) -> tuple[str, ...]:
    """Say what begins again with this press."""
    if len(presses) < 2 or presses[-1].is_start:
        return ()
    before, newest = presses[-2], presses[-1]
    if before.gel_id != newest.gel_id:
        return (
            Sentence(
                f"the first one on gel {newest.gel_id}: its charts begin again, the limits of the place remain"
            ),
        )
    if before.bundle_id != newest.bundle_id:
        return (Sentence("the first one with this bundle: the chart of the score begins again"),)
    return ()


_DAY = datetime.timedelta(days=1)


def why_due(
    last_ns: int | None,
    now_ns: int,
    every_h: float,
    shifts: Sequence[datetime.time] = (),
    zone: datetime.tzinfo | None = None,
) -> str | None:
    """Say why a reference press is due, as a sentence without its end, or None.

    last_ns, now_ns: wall clock, nanoseconds since 1970; last_ns None where there was none with this gel and
    bundle. every_h: hours, above 0.
    shifts: the local times at which shifts begin. zone: of these times; None for that of this machine.
    """
    if last_ns is None:
        return Sentence("there was none with this gel and bundle")
    if last_ns > now_ns:
        return Sentence("the last one is in the future, so the clock was set back")
    if now_ns - last_ns >= every_h * 3.6e12:
        return Sentence(f"the last one is more than {every_h:g} h old")
    begun = newest_begin(datetime.datetime.fromtimestamp(now_ns / 1e9, zone).astimezone(zone), shifts, zone)
    if begun is not None and last_ns < begun.timestamp() * 1e9:
        return Sentence(f"the shift of {begun:%H:%M} has begun since the last one")
    return None


def newest_begin(
    now: datetime.datetime, shifts: Sequence[datetime.time], zone: datetime.tzinfo | None
) -> datetime.datetime | None:
    """The newest moment at which a shift began, today or yesterday."""
    days = (now.date(), now.date() - _DAY)
    begins = (
        datetime.datetime.combine(day, shift, zone).astimezone(zone) for day in days for shift in shifts
    )
    return max((begin for begin in begins if begin <= now), default=None)
