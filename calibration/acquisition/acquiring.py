"""One acquisition: each press is kept, its features are compared with those before, and the standing is known."""

import sys
from pathlib import Path

import numpy as np

from calibration.acquisition.arguments import AcquireArguments
from calibration.acquisition.coverage import PlaceDistances, Standing
from calibration.acquisition.folder import AcquisitionFolder, KeptPress, Keys, Pieces
from calibration.acquisition.report import coverage_png
from calibration.acquisition.sources import Found
from calibration.dataset.files import read_rgb
from calibration.fitting.limits.held_out import TapReader
from calibration.fitting.presses.nominal_presses import gather_presses, require_light, touched_union
from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.core.arrays import F32, U8, Mask
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["Acquiring"]


class Acquiring:
    """Takes presses into a folder. Those already in the folder count.

    plan: with part and position. left_out: why presses were not taken, a sentence each. Errors: ConfigError for the
    folder of something else, DatasetError for a press in the folder that cannot be read.
    """

    def __init__(self, plan: AcquireArguments, profile: SensorProfile) -> None:
        self._wanted = plan.promise, plan.confidence
        self.left_out: list[str] = []
        self._profile, self._region = profile, Region.parse(plan.region, profile.size)
        detector = registry.detector(plan.method)
        self._tap = detector.taps(detector.parameters())[0]
        graph, frame = (
            open_trunk(plan.backbone, (self._tap,)).graph,
            (self._region.height, self._region.width),
        )
        self._reader = TapReader(graph, (self._tap,), frame, profile.pixels_per_mm, plan.threads)
        about = {name: str(getattr(plan, name)) for name in ("part", "position", "profile")}
        self.folder = AcquisitionFolder(plan.output, {**about, "region": str(self._region)})
        self.pieces = Pieces(self.folder.presses, plan.per_piece, Keys(sys.stdin) if plan.enter else None)
        for name, piece in self.folder.named.items():
            self.pieces.see_again(name, piece)
        self._distances = PlaceDistances()
        self._shown: U8 | None = None

        def read(path: Path) -> U8:
            return require_light(path, read_rgb(path, profile, resize=plan.resize))

        self._free = [read(path) for path in self.folder.free]
        for kept in self.folder.presses:
            rgb = read(kept.path)
            self._compare(self._features(rgb), rgb, None, kept)

    @property
    def standing(self) -> Standing:
        """The present state of the acquisition."""
        numbers = [kept.piece for kept in self.folder.presses]
        known = set(numbers) - {None}
        pieces = None if not known else len(known) + numbers.count(None)
        return Standing(len(numbers), pieces, self._distances.coverage(), *self._wanted)

    def take(self, found: Found) -> KeptPress | None:
        """Keep what was found; returns the press if it is a new one. Errors: StoreError."""
        if isinstance(found, str):
            self.left_out.append(found)
            return None
        if found.is_free:
            self.folder.add_free(found.payload)
            self._free.append(found.rgb)
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

    def _features(self, rgb: U8) -> F32:
        """The tap of one picture, float32 (c, rows, cols). Errors: FitError."""
        cut = np.ascontiguousarray(self._region.crop(rgb))
        return np.asarray(self._reader.take(cut[None])[self._tap][0], np.float32)

    def _compare(
        self,
        features: F32,
        rgb: U8,
        mask: Mask | None,
        kept: KeptPress,
    ) -> None:
        self._shown = rgb
        touched = None
        if mask is not None:
            touched = touched_union([mask], self._profile, self._region)
        elif self._free:
            free = self._free[:1]
            touched = gather_presses({"press": rgb}, self._profile, self._region, no_contact=free).touched
        self._distances.add(features, touched, None if kept.piece is None else str(kept.piece))
