"""The summary of a run, counted by the loop: presses, verdicts, times and frames."""

from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import Final

from edge.core.imaging.quality import Reason
from edge.gateway.acquisition import AcquisitionStatus
from edge.gateway.overload import FrameCounts
from edge.gateway.recorder import PressReport

__all__ = ["Summary"]

LATENCIES_KEPT: Final = 1000


@dataclass
class Summary:
    """The counts of a run. verdicts: word to number, `error` for a press without a verdict, `reference`
    and `study` for one that is no part's.

    latencies_ms: frame to verdict of the newest presses that were scored; rejected presses and errors are faster, so
    they do not count. frames: the fate of the sensor's frames. frames_corrupt: not delivered, or delivered and not
    decodable. frames_stale: came twice. has_ended: a recording was played to its end.
    """

    presses: int = 0
    has_ended: bool = False
    verdicts: Counter[str] = field(default_factory=Counter)
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES_KEPT))
    frames: FrameCounts = field(default_factory=FrameCounts)
    frames_corrupt: int = 0
    frames_stale: int = 0

    def add(self, report: PressReport) -> None:
        """One more press."""
        result = report.result
        self.presses += 1
        self.verdicts[report.word] += 1
        if result.score is not None and "total" in result.latency_ms:
            self.latencies_ms.append(result.latency_ms["total"])
        if (result.reason or "").startswith(f"{Reason.STALE}:"):
            self.frames = replace(self.frames, late_presses=self.frames.late_presses + 1)

    def add_lost(self, *, is_late: bool, was_interrupted: bool) -> None:
        """Count a frame for which this machine was too slow (see FrameCounts)."""
        self.frames = replace(
            self.frames,
            late=self.frames.late + is_late,
            interrupted=self.frames.interrupted + was_interrupted,
        )

    def see(self, sensor: AcquisitionStatus, undecodable: int) -> None:
        """Add the reader thread's counts. undecodable: frames that arrived and could not be decoded."""
        self.frames = replace(self.frames, frames=sensor.frames, dropped=sensor.dropped)
        self.frames_corrupt = sensor.corrupt + undecodable
        self.frames_stale = sensor.stale
