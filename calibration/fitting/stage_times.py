"""How far a fit is, and the processor time of its stages."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from calibration.progress import Report

__all__ = ["StageTimes"]


class StageTimes:
    """Reports how far a fit is, and measures the processor time of its stages."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.seconds: dict[str, float] = {}

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Add what is done within it to the stage."""
        start = time.process_time()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.process_time() - start
