"""Edits of real presses: small, connected, seen, away from what they must not change, and the same for one seed."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from calibration.experiments.backbones import touch_edits
from calibration.experiments.backbones.touch_edits import MIN_PEAK_LEVELS, Edited
from edge.core.errors import DatasetError

FREE = np.full((240, 320, 3), 120, np.uint8)
SPOTS = np.zeros((240, 320), np.bool_)
SPOTS[100:140, 140:180] = True


def press() -> np.ndarray:
    """A free gel with the slopes of a wavy surface in its middle."""
    rows, columns = np.mgrid[:240, :320]
    waves = 60 * np.sin(columns / 3) * ((np.abs(rows - 120) < 40) & (np.abs(columns - 160) < 40))
    return np.clip(FREE + waves[..., None], 0, 255).astype(np.uint8)


def dotted(rows: int = 7, columns: int = 10) -> np.ndarray:
    """A marker gel: a grid of dark dots of 9 pixels, 32 apart, the first at (16, 16)."""
    found = FREE.copy()
    down, across = np.mgrid[:240, :320]
    for row in range(rows):
        for column in range(columns):
            is_dot = np.hypot(down - (16 + 32 * row), across - (16 + 32 * column)) <= 4.5
            found[is_dot] = 30
    return found


def edit(seed: int = 0) -> Edited:
    donors = [touch_edits.relief(press(), FREE)]
    return touch_edits.add_relief(FREE, donors, SPOTS, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(8))
def test_a_piece_of_relief_is_small_seen_and_in_its_place(seed: int) -> None:
    """It changes a pixel by 20 levels at least, nothing outside 20 pixels around a spot, and nothing but relief: the
    mean over the piece stays within a few levels. Stripes leave no gap in its mask, and the seed alone draws it."""
    edited = edit(seed)
    change = edited.rgb.astype(float) - FREE
    rows, columns = np.nonzero(np.abs(change).max(axis=2))
    assert np.abs(change).max() >= MIN_PEAK_LEVELS
    assert np.ptp(rows) < 20
    assert np.ptp(columns) < 20
    assert 90 <= rows.min() <= rows.max() < 150
    assert 130 <= columns.min() <= columns.max() < 190
    assert abs(change[rows, columns].mean()) < 5
    assert edited.mask[np.abs(change).max(axis=2) > 0.3 * np.abs(change).max()].all()
    assert not edited.mask[np.abs(change).max(axis=2) == 0].all()
    assert cv2.connectedComponents(edited.mask.astype(np.uint8))[0] == 2
    assert np.array_equal(edited.rgb, edit(seed).rgb)
    assert not np.array_equal(edited.rgb, edit(seed + 1).rgb)


def test_pieces_are_raised_and_sunk() -> None:
    """Twenty draws of one bump's relief hold both signs at the piece's middle."""
    rows, columns = np.mgrid[:240, :320]
    bump = np.exp(-0.5 * ((rows - 120) ** 2 + (columns - 160) ** 2) / 4**2)
    donor = np.repeat(100 * bump[..., None], 3, axis=2).astype(np.float32)
    signs = set()
    for seed in range(20):
        found = touch_edits.add_relief(FREE, [donor], SPOTS, np.random.default_rng(seed))
        change = found.rgb.astype(float) - FREE
        signs.add(float(np.sign(change.flat[np.abs(change).argmax()])))
    assert signs == {-1.0, 1.0}


@pytest.mark.parametrize("share", [0, 0.25])
def test_a_flat_or_faint_donor_is_refused(share: float) -> None:
    """No relief, or waves of 15 levels, are no edit: one sentence with the number of presses and the levels."""
    faint = np.asarray(share * touch_edits.relief(press(), FREE), np.float32)
    with pytest.raises(DatasetError, match="no piece of 2 presses' relief changes a press by 20 levels"):
        touch_edits.add_relief(FREE, [faint] * 2, SPOTS, np.random.default_rng(0))


def test_another_light_is_no_relief() -> None:
    """A free gel that is 15 levels brighter has the relief 0 everywhere."""
    assert not touch_edits.relief(FREE + np.uint8(15), FREE).any()


def test_dots_are_counted() -> None:
    """Seven rows of ten dots, and none on a plain gel."""
    assert touch_edits.dots(dotted()).max() == 70
    assert touch_edits.dots(FREE).max() == 0


@pytest.mark.parametrize(("change", "left"), [(touch_edits.remove_dot, 69), (touch_edits.add_dot, 71)])
def test_a_dot_is_removed_or_added_and_the_others_stay(change: Callable[..., Edited], left: int) -> None:
    """Of 70 dots; a new one is dark and apart from the next, and no pixel outside the mask changes."""
    edited = change(dotted(), SPOTS, np.random.default_rng(0))
    assert touch_edits.dots(edited.rgb).max() == left
    assert np.array_equal(edited.rgb[~edited.mask], dotted()[~edited.mask])
    within = edited.rgb[edited.mask].astype(int)
    assert within.min() < 40 if left > 70 else np.abs(within - 120).max() <= 2
    assert (SPOTS & edited.mask).any()


def test_no_dot_to_change_is_refused() -> None:
    """A plain gel has no dot to remove and none to copy, and a spot on a dot has no room."""
    rng = np.random.default_rng(0)
    with pytest.raises(DatasetError, match="no marker dot where one is to be removed"):
        touch_edits.remove_dot(FREE, SPOTS, rng)
    with pytest.raises(DatasetError, match="no marker dot to copy"):
        touch_edits.add_dot(FREE, SPOTS, rng)
    with pytest.raises(DatasetError, match="no room for another marker dot"):
        touch_edits.add_dot(dotted(), touch_edits.near_dots(dotted()), rng)


def test_relief_between_dots_has_no_dots() -> None:
    """Dots that moved by eight pixels leave no relief: where either picture has one, it is filled."""
    moved = np.roll(dotted(), 8, axis=1)
    raw = touch_edits.relief(moved, dotted())
    filled = touch_edits.between_dots(raw, moved, dotted())
    assert np.abs(raw[40:200, 40:280]).max() == 90
    assert np.abs(filled[40:200, 40:280]).max() < 1
