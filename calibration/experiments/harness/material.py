"""What the cells of one part, position and backbone have in common: presses, features, masks."""

import importlib.metadata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.cells import Cell
from calibration.experiments.harness.feature_cache import Taken, take_features
from calibration.experiments.harness.presses import StudyPresses, open_presses, presses_of
from calibration.experiments.harness.scoring import Also, TestPresses, fit_and_score
from calibration.fitting.limits.held_out import Learner
from calibration.fitting.trunks import Trunk, open_trunk
from edge import registry
from edge.core.detector import Detector, Mode, Nominal, Progress
from edge.core.errors import ConfigError, FitError
from edge.model.onnx_validation import output_names

__all__ = ["Drawn", "Material", "Place", "fit_cell", "material", "overrides_for", "taps_of"]


@dataclass(frozen=True)
class Place:
    """What identifies material."""

    dataset: Path
    cache: Path
    part: str
    position: str
    backbone: str
    taps: tuple[str, ...]
    """The taps that are extracted, of all methods together."""

    def __str__(self) -> str:
        return f"{self.part}/{self.position} on {self.backbone}"

    def show(self, trunk: Trunk) -> Trunk:
        """Return a trunk as it sees the presses here."""
        return trunk

    def require_room(self) -> None:
        """Check the disk. Errors: StoreError where the features of large pictures do not fit on the disk."""

    def covers(self, row: Mapping[str, Any]) -> bool:
        """Return whether a row of this study was made from what is here."""
        return all(row[name] == getattr(self, name) for name in ("part", "position", "backbone"))

    def extract(self, progress: Progress = lambda fraction: None, threads: int = 1) -> "Material":
        """Return the material, its features from the cache. Errors: DatasetError, FitError, ConfigError, StoreError."""
        presses = presses_of(open_presses(self.dataset), self.part, self.position)
        return Material(self, presses, *self.take(presses, progress, threads))

    def take(self, presses: StudyPresses, progress: Progress, threads: int) -> tuple[Trunk, Taken]:
        """Return the trunk, and the features that it gives of the presses."""
        trunk = self.show(open_trunk(self.backbone, self.taps))
        return trunk, take_features(self.cache, trunk, self.taps, presses.pictures, progress, threads)


@dataclass(frozen=True)
class Material:
    """Presses with the features of all of them."""

    place: Place
    presses: StudyPresses
    trunk: Trunk
    """The one that gave the features."""
    taken: Taken

    def test(self, rows: NDArray[np.int64]) -> TestPresses:
        """Return some presses to be scored."""
        is_defective = rows >= self.presses.nominal
        masks = np.zeros((len(rows), *self.presses.masks.shape[1:]), np.bool_)
        masks[is_defective] = self.presses.masks[rows[is_defective] - self.presses.nominal]
        return TestPresses(self.taken.features, rows, masks, is_defective)

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
    """Return the material of a place; that of the last two is kept."""
    return place.extract()


@dataclass(frozen=True)
class Drawn:
    """What a cell takes of one material. learnt, tested: rows of presses."""

    material: Material
    learnt: NDArray[np.int64]
    tested: NDArray[np.int64]


def fit_cell(cell: Cell, *drawn: Drawn, also: Also = lambda each: {}) -> dict[str, Any]:
    """Fit the cell's method on all that is learnt and score all that is tested; return the columns of its row.

    also: more columns, from the scores of each material. Errors: FitError, NotScorable.
    """
    detector, overrides = registry.detector(cell.method), overrides_for(cell.method, cell.mode, cell.backbone)
    parameters, taken = detector.parameters(cell.mode, **overrides), [k.material.taken for k in drawn]
    grid = taken[0].grid_of(detector.taps(parameters))
    learnt = {
        tap: [of.features[tap][one.learnt] for of, one in zip(taken, drawn, strict=True)] for tap in grid.taps
    }
    measured = fit_and_score(
        Learner(detector, grid, parameters, cell.seed, threads=1),
        Nominal({tap: np.asarray(np.concatenate(maps)) for tap, maps in learnt.items()}),
        [k.material.test(k.tested) for k in drawn],
        also,
    )
    texts = [
        f"{name} {', '.join(map(str, value)) if isinstance(value, tuple) else value}"
        for name, value in overrides.items()
    ]
    changed = {"changed": "; ".join(texts)} if texts else {}
    return {**measured, **drawn[0].material.facts, **changed}


@lru_cache(maxsize=64)
def overrides_for(method: str, mode: Mode, backbone: str) -> dict[str, Any]:
    """Parameters that differ from the mode's, empty where the backbone gives the taps that the mode reads.

    The published InReaCh reads thirteen taps of a Wide-ResNet-50-2. With another backbone it reads its stages, on the
    grid of the middle one. Errors: ConfigError for an unknown method or backbone; FitError where nothing fits.
    """
    detector = registry.detector(method)
    wanted = set(detector.taps(detector.parameters(mode)))
    given = _find_taps(backbone, tuple(sorted(wanted)))
    if wanted <= set(given):
        return {}
    if not {"taps", "grid_tap"} <= set(vars(detector.parameters(mode))):
        raise FitError(
            f"{method} in {mode} mode reads {', '.join(sorted(wanted))}, the backbone '{backbone}' gives "
            f"{', '.join(given)}; export a trunk with these taps, or leave the method or the mode out"
        )
    return {"taps": tuple(given), "grid_tap": given[len(given) // 2]}


def _find_taps(backbone: str, wanted: tuple[str, ...]) -> list[str]:
    """The wanted taps if the backbone has them all, else those that it gives without being asked."""
    usual = open_trunk(backbone)
    given = output_names(usual.graph)
    if set(wanted) <= set(given):
        return given
    try:
        return output_names(open_trunk(backbone, wanted).graph)
    except (ConfigError, FitError):
        return given


def taps_of(methods: Iterable[str], modes: Iterable[Mode], backbone: str) -> tuple[str, ...]:
    """The taps that these methods read, sorted: they are extracted together. Errors: as `overrides_for`."""
    modes = tuple(modes)
    read: set[str] = set()
    for method in methods:
        for mode in modes:
            detector: Detector = registry.detector(method)
            read |= set(detector.taps(detector.parameters(mode, **overrides_for(method, mode, backbone))))
    return tuple(sorted(read))
