"""One acquisition: each press is kept, its features are compared with those before, and the standing is known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.acquisition.coverage import Goal, PlaceDistances, Standing
from calibration.acquisition.folder import AcquisitionFolder, KeptPress, Pieces
from calibration.acquisition.report import coverage_png
from calibration.acquisition.sources import FreeGel, LeftOut, Press
from calibration.dataset.files import read_rgb
from calibration.fitting.presses.nominal_presses import gather_presses, require_light, touched_union
from calibration.fitting.tap_reader import TapReader
from calibration.fitting.trunks import Trunk
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["Acquiring"]


class Acquiring:
    """Takes presses into a folder. tap: whose cells are compared. Presses already in the folder count.

    left_out: why presses were not taken, a sentence each. Errors: FitError for a trunk without the tap, DatasetError
    for a press in the folder that cannot be read.
    """

    def __init__(
        self,
        folder: AcquisitionFolder,
        trunk: Trunk,
        tap: str,
        profile: SensorProfile,
        region: Region,
        pieces: Pieces,
        goal: Goal,
        *,
        resize: bool = False,
        threads: int = 2,
    ) -> None:
        self.folder, self.pieces, self.goal = folder, pieces, goal
        self.left_out: list[str] = []
        self._profile, self._region, self._tap, self._resize = profile, region, tap, resize
        frame = region.height, region.width
        self._reader = TapReader(trunk.graph, (tap,), frame, profile.pixels_per_mm, threads)
        self._distances = PlaceDistances()
        self._shown: NDArray[np.uint8] | None = None
        self._free = [require_light(path, read_rgb(path, profile, resize=resize)) for path in folder.free]
        for kept in folder.presses:
            rgb = require_light(kept.path, read_rgb(kept.path, profile, resize=resize))
            self._compare(self._features(rgb), rgb, None, kept)

    @property
    def standing(self) -> Standing:
        """The present state of the acquisition."""
        numbers = [kept.piece for kept in self.folder.presses]
        known = set(numbers) - {None}
        pieces = None if not known else len(known) + numbers.count(None)
        return Standing(len(numbers), pieces, self._distances.coverage(), self.goal)

    def take(self, found: Press | FreeGel | LeftOut) -> KeptPress | None:
        """Keep what was found; returns the press if it is a new one. Errors: StoreError."""
        if isinstance(found, FreeGel):
            self.folder.add_free(found.payload)
            self._free.append(found.rgb)
            return None
        if isinstance(found, LeftOut):
            self.left_out.append(found.why)
            return None
        if (again := self.folder.find(found.payload)) is not None:
            self.pieces.see_again(found.piece, again.piece)
            return None
        try:
            features = self._features(found.rgb)
        except FitError as error:
            self.left_out.append(f"press {found.name} cannot be scored: {error}")
            return None
        kept = self.folder.add(found.payload, self.pieces.of(found.piece))
        self._compare(features, found.rgb, found.mask, kept)
        return kept

    def map(self) -> Path | None:
        """Write the map of the coverage next to the newest press; None where it is not known. Errors: StoreError."""
        coverage = self._distances.coverage()
        if coverage is None or self._shown is None:
            return None
        return self.folder.picture(coverage_png(coverage, self._region.crop(self._shown)))

    def _features(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The tap of one picture, float32 (c, rows, cols). Errors: FitError."""
        cut = np.ascontiguousarray(self._region.crop(rgb))
        return np.asarray(self._reader.take(cut[None])[self._tap][0], np.float32)

    def _compare(
        self,
        features: NDArray[np.float32],
        rgb: NDArray[np.uint8],
        mask: NDArray[np.bool_] | None,
        kept: KeptPress,
    ) -> None:
        self._shown = rgb
        piece = None if kept.piece is None else str(kept.piece)
        self._distances.add(features, self._touched(rgb, [] if mask is None else [mask]), piece)

    def _touched(
        self, rgb: NDArray[np.uint8], masks: Sequence[NDArray[np.bool_]]
    ) -> NDArray[np.bool_] | None:
        """Find where the press touches in the region, bool (h, w); None where the free gel is not known."""
        if masks:
            return touched_union(masks, self._profile, self._region)
        if not self._free:
            return None
        return gather_presses({"press": rgb}, self._profile, self._region, no_contact=self._free[:1]).touched
