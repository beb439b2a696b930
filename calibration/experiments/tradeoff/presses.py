"""The presses of a run: which are fitted, and which are scored. No piece is on both sides."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from calibration.dataset import LabelledPress, open_dataset, resolution_of, split_by_specimen
from calibration.experiments.harness.pictures import LR_VIEW
from calibration.experiments.harness.presses import StudyPresses, presses_of
from calibration.experiments.tradeoff.point import VIEWS, View
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.sources import choose_position
from edge.core.arrays import F32, U8, Mask
from edge.core.errors import DatasetError

__all__ = ["MOST", "Chosen", "choose_presses", "on_common_grid"]

HELD_OUT: Final = 0.4
"""Share of the good presses that is kept for scoring, all presses of a piece together."""

MOST: Final = 40
"""Presses that are fitted at most, and scored at most of each class."""


@dataclass(frozen=True)
class Chosen:
    """The presses of one part and position, named by their files in low resolution."""

    every: StudyPresses
    fitted: tuple[LabelledPress, ...]
    """The fitted presses, in the order in which fits take them."""
    scored: tuple[LabelledPress, ...]
    """Good ones of other pieces, then defective ones."""
    high: dict[Path, LabelledPress]
    """The same presses at high resolution, by the low-resolution file; empty where the dataset has none."""

    @property
    def label(self) -> Mask:
        """Which of the scored presses are defective, bool (scored,)."""
        return np.array([press.is_defective for press in self.scored], np.bool_)

    def sha256(self) -> str:
        """Hash the pictures and masks that are used, in their order: equal hashes mean equal presses."""
        hasher = hashlib.sha256()
        for press in (*self.fitted, *self.scored):
            for file in (press.path, press.mask_file):
                hasher.update(b"-" if file is None else hashlib.sha256(file.read_bytes()).digest())
        return hasher.hexdigest()

    def show(self, presses: Sequence[LabelledPress], view: View) -> list[LabelledPress]:
        """Return presses in the resolution of a view."""
        is_low = view.profile.size == LR_VIEW.size
        return [press if is_low else self.high[press.path] for press in presses]

    def read(self, presses: Sequence[LabelledPress], view: View) -> U8:
        """Read the pictures of presses in a view, uint8 (n, h, w, 3). Errors: DatasetError."""
        return np.stack([view.region.crop(press.rgb()) for press in self.show(presses, view)])

    def read_nominal(self, view: View) -> NominalPresses:
        """Read the fitted presses, without the free gel, which no picture shows. Errors: DatasetError."""
        names = tuple(f"{press.path.parent.name}/{press.path.name}" for press in self.show(self.fitted, view))
        pieces = tuple(press.specimen for press in self.fitted)
        return NominalPresses(self.read(self.fitted, view), names, pieces)


def choose_presses(root: Path, part: str | None, position: str | None, seed: int) -> Chosen:
    """Divide the good presses of one position by their pieces, and take the defective ones; the seed draws them.

    Errors: DatasetError for several parts, no defective press, empty masks, or pieces that cannot be divided.
    """
    low = LR_VIEW.size
    dataset = open_dataset(root, resolution_of(low))
    part, position = choose_position([dataset], part, position)
    every = presses_of(dataset, part, position)
    if every.pictures.view != LR_VIEW:
        size_text = "x".join(map(str, every.pictures.view.size))
        raise DatasetError(
            f"the pictures of {part}/{position} are {size_text}, not {low[0]}x{low[1]}; a trade-off is measured on "
            "pictures of the sensor in low resolution, with or without the high one"
        )
    assert every.masks.any()  # else refused before any work
    good, defective = every.pictures.presses[: every.nominal], every.pictures.presses[every.nominal :]
    split = split_by_specimen(good, HELD_OUT, seed)
    rng = np.random.default_rng(seed)
    fitted, apart, damaged = (
        tuple(presses[k] for k in rng.permutation(len(presses))[:MOST])
        for presses in (split.kept, split.held_out, defective)
    )
    scored = (*apart, *damaged)
    return Chosen(every, fitted, scored, _high(root, (*fitted, *scored), part, position))


def _high(
    root: Path, presses: Sequence[LabelledPress], part: str, position: str
) -> dict[Path, LabelledPress]:
    """The high-resolution press of each, by its low-resolution file; empty unless every one has one."""
    size = VIEWS["hr"].profile.size
    try:
        high_presses = open_dataset(root, resolution_of(size)).select(part, position).presses
    except DatasetError:
        return {}
    named = {(press.path.stem, press.is_defective): press for press in high_presses if press.size == size}
    pairs = {press.path: named.get((press.path.stem, press.is_defective)) for press in presses}
    return {path: press for path, press in pairs.items() if press} if all(pairs.values()) else {}


def on_common_grid(score_map: F32) -> F32:
    """A score map in the pixels of the low-resolution region, as means over areas, so that views can be compared."""
    height, width = LR_VIEW.shape
    if score_map.shape == (height, width):
        return score_map
    return np.asarray(cv2.resize(score_map, (width, height), interpolation=cv2.INTER_AREA), np.float32)
