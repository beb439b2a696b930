"""The presses of a run: which are fitted, and which are scored. No piece is on both sides."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset import LabelledPress, open_dataset, resolution_of, split_by_specimen
from calibration.dataset.press import empty_masks, repeated_pictures
from calibration.experiments.harness.pictures import LR_VIEW, PressPictures
from calibration.experiments.harness.presses import presses_of
from calibration.experiments.tradeoff.point import VIEWS, View
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from edge.core.errors import DatasetError

__all__ = ["Chosen", "Seen", "choose_presses", "see"]

HELD_OUT = 0.4
"""Share of the good presses that is kept for scoring, all presses of a piece together."""


@dataclass(frozen=True)
class Chosen:
    """The presses of one part and position, named by their files in low resolution."""

    root: Path
    part: str
    position: str
    fitted: tuple[LabelledPress, ...]
    """The fitted presses, in the order in which fits take them."""
    scored: tuple[LabelledPress, ...]
    """Good ones of other pieces, then defective ones."""
    high: dict[Path, LabelledPress]
    """The same presses at high resolution, by the low-resolution file; empty where the dataset has none."""

    @property
    def label(self) -> NDArray[np.bool_]:
        """Which of the scored presses are defective, bool (scored,)."""
        return np.array([press.is_defective for press in self.scored], np.bool_)

    @property
    def specimens(self) -> tuple[str, ...]:
        """The piece of each scored press."""
        return tuple(str(press.specimen) for press in self.scored)

    def remarks(self) -> list[str]:
        """Sentences on what may be a mistake: empty masks of some presses, and copies of pictures."""
        where, pictures = f"{self.part}/{self.position}", PressPictures((*self.fitted, *self.scored), LR_VIEW)
        defective = [press for press in self.scored if press.is_defective]
        masks = np.stack([LR_VIEW.mask(press) for press in defective])
        return [
            *empty_masks(where, defective, masks),
            *repeated_pictures(where, pictures.presses, pictures.digests),
        ]

    def sha256(self) -> str:
        """Hash the pictures and masks that are used, in their order: equal hashes mean equal presses."""
        found = hashlib.sha256()
        for press in (*self.fitted, *self.scored):
            for file in (press.path, press.mask_file):
                found.update(b"-" if file is None else hashlib.sha256(file.read_bytes()).digest())
        return found.hexdigest()


@dataclass(frozen=True)
class Seen:
    """The chosen presses in one view."""

    nominal: NominalPresses
    """The fitted ones."""
    frames: NDArray[np.uint8]
    """The scored ones, uint8 (n, h, w, 3)."""


def choose_presses(
    root: Path, part: str | None, position: str | None, *, most_fitted: int, most_scored: int, seed: int
) -> Chosen:
    """Divide the good presses of one position by their pieces, and take the defective ones.

    most_fitted, most_scored: limits on the fitted presses and on the scored ones of each class; drawn by the seed.
    Errors: DatasetError for several parts, no defective press, empty masks, or pieces that cannot be divided.
    """
    low = VIEWS["lr"].profile.size
    dataset = open_dataset(root, resolution_of(low))
    part, position = _the_one(dataset.positions, root, part, position)
    every = presses_of(dataset, part, position)
    if every.pictures.view != LR_VIEW:
        found = "x".join(map(str, every.pictures.view.size))
        raise DatasetError(
            f"the pictures of {part}/{position} are {found}, not {low[0]}x{low[1]}; a trade-off is measured on "
            "pictures of the sensor in low resolution, with or without the high one"
        )
    assert every.masks.any()  # else refused before any work
    good, defective = every.pictures.presses[: every.nominal], every.pictures.presses[every.nominal :]
    split = split_by_specimen(good, HELD_OUT, seed)
    rng = np.random.default_rng(seed)
    fitted = _draw(split.kept, most_fitted, rng)
    scored = (*_draw(split.held_out, most_scored, rng), *_draw(defective, most_scored, rng))
    high = _high(root, (*fitted, *scored), part, position)
    return Chosen(root, part, position, fitted, scored, high)


def _the_one(
    positions: Sequence[tuple[str, str]], root: Path, part: str | None, position: str | None
) -> tuple[str, str]:
    found = [pair for pair in positions if part in (None, pair[0]) and position in (None, pair[1])]
    if len(found) != 1:
        known = ", ".join("/".join(pair) for pair in positions)
        raise DatasetError(
            f"dataset '{root}' has {'several positions that fit' if found else 'no position that fits'} "
            f"{part or '*'}/{position or '*'}; choose with --part and --position among {known}"
        )
    return found[0]


def _draw(presses: Sequence[LabelledPress], most: int, rng: np.random.Generator) -> tuple[LabelledPress, ...]:
    return tuple(presses[k] for k in rng.permutation(len(presses))[:most])


def _high(
    root: Path, presses: Sequence[LabelledPress], part: str, position: str
) -> dict[Path, LabelledPress]:
    """The high-resolution press of each, by its low-resolution file; empty unless every one has one."""
    size = VIEWS["hr"].profile.size
    try:
        found = open_dataset(root, resolution_of(size)).select(part, position).presses
    except DatasetError:
        return {}
    named = {(press.path.stem, press.is_defective): press for press in found if press.size == size}
    pairs = {press.path: named.get((press.path.stem, press.is_defective)) for press in presses}
    return {path: press for path, press in pairs.items() if press} if all(pairs.values()) else {}


def see(chosen: Chosen, view: View) -> Seen:
    """Read the pictures in one view. Errors: DatasetError with every faulty picture."""
    is_low = view.profile_name == VIEWS["lr"].profile_name
    fitted, scored = (
        [press if is_low else chosen.high[press.path] for press in presses]
        for presses in (chosen.fitted, chosen.scored)
    )
    found = read_presses(
        [press.path for press in fitted],
        view.profile,
        view.region,
        specimens={press.path: press.specimen for press in fitted},
    )
    # Without the free gel, which is estimated where no picture shows it: no bank leaves out cells.
    nominal = NominalPresses(found.frames, found.names, found.specimens)
    return Seen(nominal, np.stack([view.region.crop(press.rgb()) for press in scored]))


def on_common_grid(score_map: NDArray[np.float32]) -> NDArray[np.float32]:
    """A score map in the pixels of the low-resolution region, as means over areas, so that views can be compared."""
    region = VIEWS["lr"].region
    if score_map.shape == (region.height, region.width):
        return score_map
    size = region.width, region.height
    return np.asarray(cv2.resize(score_map, size, interpolation=cv2.INTER_AREA), np.float32)
