"""The charts of one master piece at one position of a part: limits, signals, and what the newest press says.

The first `learn` presses of a chart that gave the expected verdict make its limits; later ones are compared with them,
and never move them. Score belongs to a bundle and a gel, strength and noise to a gel, the place to neither: after a
change of gel the place is still compared, with the limits from before.

Ref: ASTM E2587 (control charts in SPC), individuals chart; AIAG, Statistical Process Control, 2nd edition, chapter II.
Limits are the mean +- 2.66 mean moving ranges, which is +- 3 sigma with sigma = mean moving range / 1.128.

The rules are those of the Western Electric handbook (1956). With limits that are known exactly, on independent normal
values, the average number of values between two false alarms is 370 with the first rule alone, 225 with the first and
the second, 153 with the first and the fourth, 122 with all three (Champ and Woodall, Technometrics 29, 1987, table 1).
The third rule (four of five beyond one sigma) and the rule of six rising values are left out: they find little that
the others do not, and with all four Western Electric rules an alarm comes every 92 values.
"""

import datetime
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Self

from edge.core.reference_press.outcome import Imprint, Measure, Outcome, Signal
from edge.core.sentence import Sentence

__all__ = [
    "MEASURES",
    "Chart",
    "Judgement",
    "Limits",
    "ReferencePress",
    "charts",
    "judge",
    "newest_begin",
    "signals",
    "why_due",
]

# Verdicts with a score.
_SCORED: Final = ("pass", "fail", "unsure")


MEASURES: Final[tuple[Measure, ...]] = (
    # 1 % of the master piece's own score: int8 and fp32 trunks, or two processors, differ by less.
    Measure("score", "score", "", "bundle", 1e-6, 0.01, "clean gel and master piece, look at its picture"),
    # The strength of one press held still changes by about 1 %.
    Measure(
        "strength_levels", "strength", "levels", "gel", 0.01, 0.01, "check the force, the stop and the gel"
    ),
    # A twentieth of a millimetre, about one pixel at 320x240: a finer place is not meant.
    Measure("x_mm", "place x", "mm", "place", 0.05, 0.0, "check fixture and sensor mount"),
    Measure("y_mm", "place y", "mm", "place", 0.05, 0.0, "check fixture and sensor mount"),
    # The registration's own standard deviation is a tenth of a degree on long parts.
    Measure("turn_deg", "turn", "deg", "place", 0.1, 0.0, "check fixture and sensor mount"),
    Measure("noise_levels", "noise", "levels", "gel", 0.05, 0.05, "check light, exposure and cable"),
)
"""In the order in which they are shown."""


# The mean range of two normal values in standard deviations: d2 of ASTM E2587, table 6.
D2: Final = 1.128
# Limits are this many standard deviations from the centre.
LIMIT_SIGMAS: Final = 3.0
# The second Western Electric rule: two of three values beyond two sigmas.
WARNING_SIGMAS: Final = 2.0
# The fourth one: this many values in a row on one side of the centre.
RUN_LENGTH: Final = 8


@dataclass(frozen=True)
class Limits:
    """The centre, and one standard deviation of a single value, both finite; sigma is above 0."""

    centre: float
    sigma: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.centre) and math.isfinite(self.sigma) and self.sigma > 0):
            raise ValueError(f"limits are finite and sigma is above 0, found {self.centre} and {self.sigma}")

    @classmethod
    def of(cls, values: Sequence[float], floor: float) -> Self:
        """Compute limits from values in the order in which they were taken, at least two.

        floor: sigma is not less than this, above 0: values that repeat exactly would make every later one an alarm.
        """
        if len(values) < 2:
            raise ValueError(f"limits need two values or more, found {len(values)}")
        ranges = [abs(later - earlier) for earlier, later in pairwise(values)]
        return cls(math.fsum(values) / len(values), max(math.fsum(ranges) / len(ranges) / D2, floor))

    @property
    def low(self) -> float:
        return self.centre - LIMIT_SIGMAS * self.sigma

    @property
    def high(self) -> float:
        return self.centre + LIMIT_SIGMAS * self.sigma

    def sigmas(self, value: float) -> float:
        """Measure how far a value is from the centre, signed."""
        return (value - self.centre) / self.sigma


def signals(values: Sequence[float], limits: Limits) -> tuple[Signal, ...]:
    """Find what the last of the values signals; empty for nothing. values: oldest first."""
    distances = [limits.sigmas(value) for value in values]
    if not distances:
        return ()
    side = math.copysign(1.0, distances[-1])
    last = [side * far for far in distances[-RUN_LENGTH:]]
    rules = {
        Signal.BEYOND_LIMIT: last[-1] > LIMIT_SIGMAS,
        Signal.TWO_OF_THREE: last[-1] > WARNING_SIGMAS
        and sum(far > WARNING_SIGMAS for far in last[-3:]) >= 2,
        Signal.RUN_OF_EIGHT: len(last) == RUN_LENGTH and min(last) > 0,
    }
    return tuple(signal for signal, is_so in rules.items() if is_so)


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
    readings = [(one, one.value(measure)) for one in _in_scope(measure, presses)]
    measured = _without_turns([(one, value) for one, value in readings if value is not None], measure.unit)
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
    shifts: Sequence[datetime.time],
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
