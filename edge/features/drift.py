"""Drift of ordinary production: charts of the passing presses, and an alarm with what has shifted and what to do."""

import logging
from collections.abc import Mapping
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.events import PressSettled
from edge.core.drift import MEASURES, DriftChart
from edge.core.press import Press
from edge.core.reference_press.outcome import Imprint
from edge.core.verdict import Kind
from edge.model.inspector import Inspector
from edge.press_stage import Alarms, PressStage, StageParts
from edge.store.gel_files import GelFiles
from edge.store.gel_ledger import GelRecord

__all__ = ["DriftWatch"]

log = logging.getLogger(__name__)

# They are kept after this number of presses.
_KEPT_EVERY: Final = 16
# Bundles whose charts are kept for a gel, the newest in use.
_KEPT_BUNDLES: Final = 32

Charts = dict[str, DriftChart]


class DriftWatch(PressStage):
    """Charts of each bundle on the mounted gel; another gel begins new ones."""

    def __init__(self, folder: GelFiles, alarms: Alarms) -> None:
        self._folder, self._alarms = folder, alarms
        self._serial, self._gel_id, self._unsaved = "", "", 0
        self._bundles: dict[int, Charts] = {}
        self._bundle = 0

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Charts are kept next to the database, with the gel's pictures."""
        return cls(GelFiles(parts.config.store.path.with_suffix(".references")), parts.alarms)

    def mount(self, gel: GelRecord) -> None:
        """Go on with the charts of this gel; an unknown one has none."""
        self._save()
        self._serial, self._gel_id = gel.serial, gel.gel_id
        self._bundles = self._folder.load(gel.serial, gel.gel_id, "drift", _bundles_from) or {}
        self._say()

    def use(self, inspector: Inspector) -> None:
        """Go on with the charts of this bundle."""
        self._bundle = int(inspector.bundle.digest[:12], 16)
        self._say()

    def close(self) -> None:
        self._save()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Chart it where it passes: damage is no drift."""
        if press.label is None and settled is not None and press.word == Kind.PASS.value:
            charts = self._bundles.pop(self._bundle, {})
            for measure in MEASURES:
                value = _measure(press, settled, inspector).get(measure.name)
                if value is not None:
                    charts[measure.name] = charts.get(measure.name, DriftChart()).add(value, measure)
            self._bundles[self._bundle] = charts  # the last one is the newest in use
            self._unsaved += 1
            self._say()
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        """Keep the charts where they are due: a result does not wait for a file."""
        if self._unsaved >= _KEPT_EVERY:
            self._save()

    def acknowledge(self, alarm: str) -> None:
        """Begin the charts that have shifted again: what they show now is right from now on."""
        if alarm == "drift":
            charts = self._bundles.get(self._bundle, {})
            self._bundles[self._bundle] = {name: chart for name, chart in charts.items() if not chart.shift}
            self._unsaved += 1
            self._save()

    def _say(self) -> None:
        charts = self._bundles.get(self._bundle, {})
        shifted = [
            charts[measure.name].describe(measure)
            for measure in MEASURES
            if measure.name in charts and charts[measure.name].shift
        ]
        self._alarms.say("drift", "; ".join(shifted) or None, "warning")

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


def _measure(press: Press, settled: PressSettled, inspector: Inspector) -> Mapping[str, float | None]:
    verdict, findings = press.verdict, settled.findings
    score, threshold = (None, None) if verdict is None else (verdict.score, verdict.threshold)
    return {
        **vars(Imprint.of(settled, inspector.bundle.profile)),
        "score_ratio": score / threshold if score is not None and threshold else None,
        "light_levels": None if findings is None else float(findings.free.mean()),
    }


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
