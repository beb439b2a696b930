"""Size and depth of a deviation in mm, on the topic `deviations/<press id>`: of a gel whose heights are calibrated."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Self

from edge.config import Config
from edge.core.press import Press
from edge.core.verdict import Kind
from edge.heights.files import read_calibration
from edge.messaging.result_payload import MOST_DEFECTS
from edge.model.bundle import Bundle
from edge.model.deviations import DeviationMeter
from edge.model.inspector import Inspector
from edge.press_stage import PressStage, StageParts
from edge.store.gel_ledger import GelRecord

__all__ = ["Deviations"]


class Deviations(PressStage):
    """Gives each press that does not pass what measures it; the thread of the pictures calls that."""

    def __init__(self, meter: DeviationMeter) -> None:
        self._meter = meter
        self._serial: str | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        path = parts.config.gel.heights
        return None if path is None else cls(DeviationMeter(read_calibration(path)))

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        if (path := config.gel.heights) is not None:
            yield "gel.heights", lambda: f"calibration '{read_calibration(path).name}'"

    def mount(self, gel: GelRecord) -> None:
        """A calibration is of one sensor."""
        self._serial = gel.serial

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """Measure it later, where it has something to measure."""
        return self.draw_again(press, inspector.bundle) if press.label is None else press

    def draw_again(self, press: Press, bundle: Bundle) -> Press:
        """Have it measured before its picture is drawn."""
        verdict, is_scored = press.verdict, press.score_map is not None and press.score is not None
        if verdict is None or not is_scored or verdict.kind is Kind.PASS:
            return press
        find = partial(press.find_places, bundle.manifest.threshold.value)
        measure, serial = self._meter.measure, self._serial
        return replace(press, measure=lambda: measure(press, find()[:MOST_DEFECTS], bundle, serial))

    def fields(self, press: Press) -> Mapping[str, Any]:
        """Say where its deviations are sent."""
        return {"deviations_topic": f"deviations/{press.press_id}"} if press.measure else {}
