"""The presses of a study: of one part at one position, checked, with the held-out ones apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.dataset import SIZES, Dataset, LabelledPress, Resolution, open_dataset, split_by_specimen
from calibration.dataset.press import empty_masks, repeated_pictures
from calibration.experiments.harness.cells import Split
from calibration.experiments.harness.pictures import LR_VIEW, PressPictures, View
from edge.core.arrays import Mask
from edge.core.errors import DatasetError
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import CENTRE_SIDE, Region

__all__ = ["TEST_SEED", "HeldOut", "StudyPresses", "hold_out", "open_presses", "presses_of", "subset"]

TEST_SEED = 42
"""The paper's: the same test presses in every cell."""

MVTEC_POSITION = "all"
"""The position of every press of an MVTec folder, whose own division into train and test is not used."""


@dataclass(frozen=True)
class StudyPresses:
    """Presses of one part at one position: the nominal ones first, then the defective ones."""

    part: str
    position: str
    pictures: PressPictures
    nominal: int

    @property
    def specimens(self) -> tuple[str | None, ...]:
        """The pieces of the nominal presses."""
        return tuple(press.specimen for press in self.pictures.presses[: self.nominal])

    def tested(self, held: "HeldOut") -> NDArray[np.int64]:
        """Return the rows that are scored: the held-out presses, and all defective ones."""
        return np.concatenate([held.test, self.defective])

    @property
    def defective(self) -> NDArray[np.int64]:
        """The rows of the defective presses."""
        return np.arange(self.nominal, len(self.pictures))

    @cached_property
    def masks(self) -> Mask:
        """The masks of the defective presses, bool (n, h, w). Errors: DatasetError where all are empty."""
        masks = self.pictures.masks(self.defective)
        if not masks.any():
            raise DatasetError(
                f"the masks of all {len(masks)} defective presses of {self.part}/{self.position} are "
                "empty in the inspected region: no damage can be found there; export masks that show it"
            )
        return masks

    @cached_property
    def remarks(self) -> list[str]:
        """Sentences on what may be a mistake: empty masks of some presses, and copies of pictures."""
        presses, where = self.pictures.presses, f"{self.part}/{self.position}"
        return [
            *empty_masks(where, presses[self.nominal :], self.masks),
            *repeated_pictures(where, presses, self.pictures.digests),
        ]


@dataclass(frozen=True)
class HeldOut:
    """Rows of nominal presses, rising: the test presses, and the pool that training presses are drawn from."""

    test: NDArray[np.int64]
    pool: NDArray[np.int64]


def open_presses(root: Path, resolution: Resolution = "lr") -> Dataset:
    """A dataset as a study sees it. Errors: DatasetError."""
    dataset = open_dataset(root, resolution)
    if dataset.layout != "mvtec":
        return dataset
    return replace(dataset, presses=tuple(replace(p, position=MVTEC_POSITION) for p in dataset.presses))


def presses_of(dataset: Dataset, part: str, position: str) -> StudyPresses:
    """The presses of a part at a position. Errors: DatasetError for one class alone, mixed sizes, or empty masks."""
    chosen = dataset.select(part, position)
    where = f"dataset '{dataset.root}' has"
    if not chosen.defective:
        raise DatasetError(
            f"{where} no defective press of {part}/{position}: nothing shows what is found; add pictures of damaged "
            "parts with their masks"
        )
    if not chosen.good:
        raise DatasetError(f"{where} no nominal press of {part}/{position}; add pictures of sound parts")
    presses = (*chosen.good, *chosen.defective)
    return StudyPresses(part, position, PressPictures(presses, _view(presses, where)), len(chosen.good))


def _view(presses: Sequence[LabelledPress], where: str) -> View:
    sizes = sorted({press.size for press in presses})
    if len(sizes) > 1:
        sizes_text = ", ".join(f"{w}x{h}" for w, h in sizes)
        raise DatasetError(
            f"{where} pictures of several sizes ({sizes_text}) at one position; give pictures of one size"
        )
    if sizes[0] == SIZES["lr"]:
        return LR_VIEW
    fits = min(sizes[0]) >= CENTRE_SIDE
    return View(sizes[0], Region.centre(sizes[0]) if fits else Region.full(sizes[0]), LR_PIXELS_PER_MM)


def hold_out(presses: StudyPresses, count: int, split: Split, seed: int = TEST_SEED) -> HeldOut:
    """Hold out nominal presses for the test, drawn by the seed.

    split: `press` holds out exactly `count`, each alone, as the paper does; `specimen` holds out complete specimens
    until there are at least `count`. Errors: DatasetError where no press or no second specimen is left.
    """
    n = presses.nominal
    if n <= count:
        raise DatasetError(
            f"{presses.part}/{presses.position} has {n} nominal presses, and {count} are held out for the test; "
            "press more, or hold out fewer with --held-out"
        )
    if split == "press":
        order = np.random.default_rng(seed).permutation(n)
        return HeldOut(np.sort(order[:count]), np.sort(order[count:]))
    nominal = presses.pictures.presses[:n]
    apart = {press.path for press in split_by_specimen(nominal, count / n, seed).held_out}
    is_apart = np.array([press.path in apart for press in nominal])
    return HeldOut(np.flatnonzero(is_apart), np.flatnonzero(~is_apart))


def subset(pool: NDArray[np.int64], count: int, seed: int) -> NDArray[np.int64]:
    """`count` rows of the pool, drawn by the seed, rising. Of one seed, a smaller subset is part of a larger one."""
    return np.sort(np.random.default_rng(seed).permutation(pool)[:count])
