"""Lights, relays and gates follow the presses of parts; master pieces and studies switch nothing."""

from typing import Final, final

from edge.core.contact.events import Event, PressBegan, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.ports import Clock
from edge.core.press import Press
from edge.gateway.digital_io.station_io import StationIo
from edge.gateway.inspector import Inspector
from edge.gateway.press_stage import Mounted, PressStage
from edge.gateway.recorder import PressReport

__all__ = ["Outputs"]


# Nobody changes a part faster: a pass that is older than the last picture of the gel may be another part's.
_UNSEEN_S: Final = 0.5


@final
class Outputs(PressStage):
    """The last stage: it shows what the others have decided."""

    def __init__(self, io: StationIo, clock: Clock) -> None:
        self._io, self._clock = io, clock
        self._seen_ns: int | None = None

    def see(self, event: Event) -> None:
        if isinstance(event, PressBegan):
            self._io.began()

    def look(self, look: Look) -> None:
        if look.sight.lost is None and look.sight.since_ns == look.timestamp_ns:
            self._seen_ns = self._clock.monotonic_ns()

    def turn(self, mounted: Mounted | None) -> None:
        if self._seen_ns is not None and self._clock.monotonic_ns() - self._seen_ns > _UNSEEN_S * 1e9:
            self._io.forget_pass()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        if press.label is None:
            self._io.judged(press.word, self._since(press.judged_ns))
        return press

    def record(self, report: PressReport) -> None:
        self._io.recorded(report.word, self._since(report.judged_ns))

    def _since(self, judged_ns: int | None) -> int:
        """Return from when deadlines count: the judged frame, or now where there is none."""
        return self._clock.monotonic_ns() if judged_ns is None else judged_ns
