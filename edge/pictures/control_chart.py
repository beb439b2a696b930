"""Control charts as one SVG: a strip for each measure, with limits, centre, and the values that say something."""

from collections.abc import Sequence
from typing import Final
from xml.sax.saxutils import escape

from edge.core.reference_press.charts import Chart, Limits, signals
from edge.core.reference_press.outcome import Signal

__all__ = ["control_charts_svg"]

WIDTH: Final = 760
STRIP: Final = 130
# Room for the words on the left and the limits on the right.
LEFT, RIGHT, TOP = 90, 90, 34
# The newest presses that are drawn: more would be closer than a point is wide.
MOST: Final = 120
_STYLE: Final = (
    "text{font:12px sans-serif;fill:#222}.line{fill:none;stroke:#225;stroke-width:1.2}.limit{stroke:#b00;"
    "stroke-dasharray:5 3}.centre{stroke:#888}.point{fill:#225}.said{fill:#e80}.out{fill:#c00}.small{font-size:10px}"
)


def control_charts_svg(charts: Sequence[Chart], title: str) -> str:
    """A complete SVG document. A red point is beyond a limit, an orange one ends a run."""
    height = TOP + STRIP * len(charts)
    strips = "\n".join(_strip(chart, TOP + STRIP * number) for number, chart in enumerate(charts))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        f'role="img"><title>{escape(title)}</title><style>{_STYLE}</style>\n'
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/><text x="8" y="20">{escape(title)}</text>\n'
        f"{strips}\n</svg>\n"
    )


def _strip(chart: Chart, top: int) -> str:
    values, limits = chart.values[-MOST:], chart.limits
    low, high = _range(values, limits)
    scale = (STRIP - 30) / (high - low)

    def y(value: float) -> float:
        return round(top + 15 + (high - value) * scale, 1)

    step = (WIDTH - LEFT - RIGHT) / max(len(values) - 1, 1)
    places = [(round(LEFT + number * step, 1), y(value)) for number, value in enumerate(values)]
    unit = f" ({chart.measure.unit})" if chart.measure.unit else ""
    parts = [f'<text x="8" y="{top + 30}">{escape(chart.measure.title + unit)}</text>']
    if limits is not None:
        parts += [_level(y(limits.low), limits.low, "limit"), _level(y(limits.high), limits.high, "limit")]
        parts += [_level(y(limits.centre), limits.centre, "centre")]
    else:
        parts += [f'<text class="small" x="8" y="{top + 46}">{chart.learnt} of {chart.learn} learnt</text>']
    parts += [f'<polyline class="line" points="{" ".join(f"{a},{b}" for a, b in places)}"/>']
    offset = len(chart.values) - len(values)
    for number, (a, b) in enumerate(places):
        kind = _kind(chart, offset + number)
        parts.append(f'<circle class="{kind}" cx="{a}" cy="{b}" r="{2.5 if kind == "point" else 4}"/>')
    return "".join(parts)


def _kind(chart: Chart, number: int) -> str:
    """Name the kind of a value: out, said or point. Values of which the limits are made are points."""
    made = [press for press in chart.presses if press.is_as_expected][: chart.learn]
    if chart.limits is None or chart.presses[number] in made:
        return "point"
    chart_signals = signals(chart.values[: number + 1], chart.limits)
    if Signal.BEYOND_LIMIT in chart_signals:
        return "out"
    return "said" if chart_signals else "point"


def _level(y: float, value: float, kind: str) -> str:
    return (
        f'<line class="{kind}" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y}" y2="{y}"/>'
        f'<text class="small" x="{WIDTH - RIGHT + 6}" y="{y + 3}">{value:.4g}</text>'
    )


def _range(values: Sequence[float], limits: Limits | None) -> tuple[float, float]:
    """Give the range of a strip: every value and both limits, with some room."""
    shown = [*values, *([limits.low, limits.high] if limits is not None else [])]
    low, high = min(shown), max(shown)
    room = 0.05 * (high - low) or max(abs(high), 1.0) * 0.05
    return low - room, high + room
