"""Lights, relays and gates follow the presses of parts; master pieces and studies switch nothing."""

from typing import final

from edge.core.contact.events import Event, PressBegan, PressSettled
from edge.core.ports import Clock
from edge.core.press import Press
from edge.gateway.digital_io.station_io import StationIo
from edge.gateway.inspector import Inspector
from edge.gateway.press_stage import PressStage
from edge.gateway.recorder import PressReport

__all__ = ["Outputs"]


@final
class Outputs(PressStage):
    """The last stage: it shows what the others have decided."""

    def __init__(self, io: StationIo, clock: Clock) -> None:
        self._io, self._clock = io, clock

    def see(self, event: Event) -> None:
        if isinstance(event, PressBegan):
            self._io.began()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        if press.label is None:
            self._io.judged(press.word, self._since(press.judged_ns))
        return press

    def record(self, report: PressReport) -> None:
        self._io.recorded(report.word, self._since(report.judged_ns))

    def _since(self, judged_ns: int | None) -> int:
        """Return from when deadlines count: the judged frame, or now where there is none."""
        return self._clock.monotonic_ns() if judged_ns is None else judged_ns
