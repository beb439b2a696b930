"""One trunk, whose features of presses serve every method."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.limits.held_out import Learner
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.detector import Detector, Features, Nominal, Progress
from edge.model.session import open_session

__all__ = ["TapReader"]


class TapReader:
    """Reads taps of frames by a trunk. frame: (h, w). Errors: FitError for a trunk that lacks a tap."""

    def __init__(
        self,
        graph: bytes,
        taps: Sequence[str],
        frame: tuple[int, int],
        pixels_per_mm: float,
        threads: int = 1,
        name: str = "trunk",
    ) -> None:
        self._session, self._threads = open_session(graph, threads, name), threads
        self.grid = trunk_grid(self._session, taps, frame, pixels_per_mm)

    def take(self, frames: NDArray[np.uint8], progress: Progress = lambda fraction: None) -> Features:
        """Return every tap of frames, uint8 (n, h, w, 3)."""
        return extract(self._session, frames, self.grid, progress)

    def nominal(self, presses: NominalPresses, progress: Progress = lambda fraction: None) -> Nominal:
        """Return what is learnt from presses."""
        free, features = presses.no_contact, self.take(presses.frames, progress)
        return Nominal(features, presses.touched, None if free is None else self.take(free))

    def learner(self, detector: Detector, parameters: Any = None, seed: int = 0) -> Learner:
        """Return the learner of a detector, with its defaults if no parameters are given."""
        parameters = parameters or detector.parameters()
        grid = replace(self.grid, taps={tap: self.grid.taps[tap] for tap in detector.taps(parameters)})
        return Learner(detector, grid, parameters, seed, self._threads)
