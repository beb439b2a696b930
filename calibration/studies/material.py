"""What the cells of one part, position and backbone have in common: presses, features, masks; kept by each process."""

import importlib.metadata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.remarks import empty_masks, repeated_pictures
from calibration.fitting.trunks import Trunk, open_trunk
from calibration.studies.feature_cache import FeatureCache, Taken
from calibration.studies.presses import StudyPresses, opened, presses_of
from calibration.studies.scoring import TestPresses
from edge.core.detector import Nominal, Progress
from edge.core.errors import DatasetError

__all__ = ["Material", "Place", "extracted", "material"]


@dataclass(frozen=True)
class Place:
    """What identifies material. taps: those that are extracted, of all methods together."""

    dataset: Path
    cache: Path
    part: str
    position: str
    backbone: str
    taps: tuple[str, ...]


@dataclass(frozen=True)
class Material:
    """Presses with the features of all of them. backbone: as in the cell. trunk: the one that gave the features."""

    presses: StudyPresses
    backbone: str
    trunk: Trunk
    taken: Taken

    def nominal(self, rows: NDArray[np.int64], taps: Sequence[str]) -> Nominal:
        """What is learnt from some nominal presses."""
        return Nominal(self.taken.of(rows, taps))

    def test(self, nominal: NDArray[np.int64], taps: Sequence[str]) -> TestPresses:
        """Some nominal presses and all defective ones."""
        rows = np.concatenate([nominal, self.presses.defective])
        return TestPresses(
            self.taken.each(rows, taps),
            np.concatenate([np.zeros((len(nominal), *self.masks.shape[1:]), np.bool_), self.masks]),
            rows >= self.presses.nominal,
        )

    @cached_property
    def masks(self) -> NDArray[np.bool_]:
        """Of the defective presses, bool (n, h, w). Errors: DatasetError where all are empty."""
        masks = self.presses.pictures.masks(self.presses.defective)
        if not masks.any():
            raise DatasetError(
                f"the masks of all {len(masks)} defective presses of {self.presses.part}/{self.presses.position} are "
                "empty in the inspected region: no damage can be found there; export masks that show it"
            )
        return masks

    @cached_property
    def remarks(self) -> list[str]:
        """Sentences on what may be a mistake: empty masks of some presses, and copies of pictures."""
        presses, where = self.presses.pictures.presses, f"{self.presses.part}/{self.presses.position}"
        return [
            *empty_masks(where, presses[self.presses.nominal :], self.masks),
            *repeated_pictures(where, presses, self.presses.pictures.digests),
        ]

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Columns that say what the rows were made from, the same on every machine."""
        return {
            "pictures_sha256": self.presses.pictures.sha256[:16],
            "trunk_sha256": self.trunk.sha256[:16],
            "weights": str(
                self.trunk.facts.get("weights") or self.trunk.facts.get("file", "of unknown origin")
            ),
            "program": importlib.metadata.version("gelgate"),
        }


@lru_cache(maxsize=2)
def material(place: Place) -> Material:
    """The material of a place, its features from the cache.

    Errors: DatasetError, FitError, ConfigError, StoreError.
    """
    return extracted(place)


def extracted(place: Place, progress: Progress = lambda fraction: None, threads: int = 1) -> Material:
    """The same, with the progress of an extraction."""
    presses = presses_of(opened(place.dataset), place.part, place.position)
    trunk = open_trunk(place.backbone, place.taps)
    cache = FeatureCache(place.cache)
    taken = cache.features(trunk, place.taps, presses.pictures, progress, threads)
    found = Material(presses, place.backbone, trunk, taken)
    assert found.masks.any()  # refused here, not in the first cell
    return found
