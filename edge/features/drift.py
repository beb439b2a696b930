"""Drift of ordinary production: charts of the passing presses, and an alarm with what has shifted and what to do."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.events import PressSettled
from edge.core.contact.reference import View
from edge.core.drift import LEARNT, MEASURES, DriftChart, H
from edge.core.press import Press
from edge.core.reference_press.outcome import Imprint, Measure
from edge.core.sentence import join_sentences
from edge.core.verdict import Kind
from edge.messaging.status_payloads import ChartPart, DriftPayload
from edge.model.inspector import Inspector
from edge.press_stage import PressStage, StageParts
from edge.store.gel_files import GelFiles
from edge.store.gel_ledger import GelRecord

__all__ = ["DriftWatch"]

# They are kept after this number of presses.
_KEPT_EVERY: Final = 16
# Bundles whose charts are kept for a gel, the newest in use.
_KEPT_BUNDLES: Final = 32
# Presses that are drawn: more would be closer than a point is wide.
_DRAWN: Final = 60

Charts = dict[str, DriftChart]


class DriftWatch(PressStage):
    """Charts of each bundle on the mounted gel; another gel begins new ones."""

    def __init__(self, parts: StageParts) -> None:
        self._folder = GelFiles(parts.config.store.path.with_suffix(".references"))
        self._alarms, self._announce, self._clock = parts.alarms, parts.announce, parts.clock
        self._serial, self._gel_id, self._unsaved = "", "", 0
        self._bundles: dict[int, Charts] = {}
        self._bundle = 0
        self._inspector: Inspector | None = None
        self._sums: dict[tuple[int, str], deque[tuple[float, float]]] = {}
        self._is_shown = True

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Charts are kept next to the database, with the gel's pictures."""
        return cls(parts)

    def mount(self, gel: GelRecord) -> None:
        """Go on with the charts of this gel; an unknown one has none."""
        self._save()
        self._serial, self._gel_id = gel.serial, gel.gel_id
        self._bundles = self._folder.load(gel.serial, gel.gel_id, "drift", _bundles_from) or {}
        self._sums = {}
        self._say()
        self._show()

    def use(self, inspector: Inspector) -> None:
        """Go on with the charts of this bundle."""
        self._bundle, self._inspector = int(inspector.bundle.digest[:12], 16), inspector
        self._say()
        self._show()

    def close(self) -> None:
        self._save()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Chart it where it passes: damage is no drift."""
        if press.label is None and settled is not None and press.word == Kind.PASS.value:
            charts, values = self._bundles.pop(self._bundle, {}), _measure(press, settled, inspector)
            for measure in MEASURES:
                value = values.get(measure.name)
                if value is not None:
                    chart = charts[measure.name] = charts.get(measure.name, DriftChart()).add(value, measure)
                    drawn = self._sums.setdefault((self._bundle, measure.name), deque(maxlen=_DRAWN))
                    drawn.append((round(chart.above, 2), round(chart.below, 2)))
            self._bundles[self._bundle] = charts  # the last one is the newest in use
            self._unsaved += 1
            self._is_shown = False
            self._say()
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        """Show the charts, and keep them where they are due: a result waits for neither."""
        if not self._is_shown:
            self._show()
        if self._unsaved >= _KEPT_EVERY:
            self._save()

    def acknowledge(self, alarm: str) -> None:
        """Begin the charts that have shifted again: what they show now is right from now on."""
        if alarm == "drift":
            charts = self._bundles.get(self._bundle, {})
            self._bundles[self._bundle] = {name: chart for name, chart in charts.items() if not chart.shift}
            for name in charts.keys() - self._bundles[self._bundle].keys():
                self._sums.pop((self._bundle, name), None)
            self._unsaved += 1
            self._save()
            self._show()

    def _show(self) -> None:
        """Publish the charts of the bundle in use, with the newest presses since the start."""
        self._is_shown = True
        if self._inspector is None or not self._gel_id:
            return
        charts, manifest = self._bundles.get(self._bundle, {}), self._inspector.bundle.manifest
        payload = DriftPayload(
            time_ns=self._clock.time_ns(),
            part=manifest.part,
            position=manifest.position,
            gel_id=self._gel_id,
            learnt=LEARNT,
            limit=H,
            charts=tuple(
                _chart_part(measure, charts[measure.name], self._sums.get((self._bundle, measure.name), ()))
                for measure in MEASURES
                if measure.name in charts
            ),
        )
        self._announce(payload.message())

    def _say(self) -> None:
        charts = self._bundles.get(self._bundle, {})
        shifted = [
            charts[measure.name].describe(measure)
            for measure in MEASURES
            if measure.name in charts and charts[measure.name].shift
        ]
        self._alarms.say("drift", join_sentences(shifted), "warning")

    def _save(self) -> None:
        """Keep the charts where they have changed. Never raises."""
        if not self._unsaved:
            return
        self._unsaved = 0
        rows = [
            [bundle, number, *charts[measure.name].numbers]
            for bundle, charts in list(self._bundles.items())[-_KEPT_BUNDLES:]
            for number, measure in enumerate(MEASURES)
            if measure.name in charts
        ]
        self._folder.save(self._serial, self._gel_id, "drift", np.array(rows, np.float64))


def _chart_part(measure: Measure, chart: DriftChart, sums: Iterable[tuple[float, float]]) -> ChartPart:
    drawn = tuple(sums)
    return ChartPart(
        measure=measure.name,
        title=measure.title,
        unit=measure.unit,
        count=chart.count,
        newest=float(f"{chart.newest:.6g}"),
        mean=float(f"{chart.mean:.6g}"),
        above=tuple(above for above, _ in drawn),
        below=tuple(below for _, below in drawn),
        shift=chart.shift,
        what_to_do=measure.what_to_do,
    )


def _measure(press: Press, settled: PressSettled, inspector: Inspector) -> Mapping[str, float | None]:
    verdict, findings = press.verdict, settled.findings
    score, threshold = (None, 0.0) if verdict is None else (verdict.score, verdict.threshold or 0.0)
    return {
        **vars(Imprint.of(settled, inspector.bundle.profile)),
        "score_ratio": score / threshold if score is not None and threshold > 0 else None,
        "light_levels": None if findings is None else _light(press, findings.free, inspector),
    }


def _light(press: Press, free: View, inspector: Inspector) -> float:
    """Return the mean level of the free gel: by the light that is followed, or the picture that was learnt, which may
    be hours old."""
    at_fit = inspector.bundle.free_reference
    return float((free if press.light is None or at_fit is None else press.light.undo(at_fit.view)).mean())


def _bundles_from(array: NDArray[Any]) -> dict[int, Charts]:
    """Read what `_save` wrote. Errors: ValueError."""
    bundles: dict[int, Charts] = {}
    if array.size == 0:
        return bundles
    if array.ndim != 2 or array.dtype != np.float64:
        raise ValueError(f"it is {array.dtype} {array.shape}")
    for bundle, number, *numbers in array.tolist():
        if not 0 <= number < len(MEASURES):
            raise ValueError(f"there is no measure {number}")
        name = MEASURES[int(number)].name
        bundles.setdefault(int(bundle), {})[name] = DriftChart.from_numbers(numbers)
    return bundles
