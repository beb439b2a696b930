"""Edits of real presses: small, connected, seen, away from what they must not change, and the same for one seed."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
import touch_edits
from touch_edits import MIN_PEAK_LEVELS, Edited

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


@pytest.mark.parametrize(("change", "left"), [(touch_edits.remove_dot, 69), (touch_edits.add_dot, 71)])
def test_a_dot_is_removed_or_added_and_the_others_stay(change: Callable[..., Edited], left: int) -> None:
    """Of 70 dots; a new one is dark and apart from the next, and no pixel outside the mask changes."""
    edited = change(dotted(), SPOTS, np.random.default_rng(0))
    assert touch_edits.dots(edited.rgb).max() == left
    assert np.array_equal(edited.rgb[~edited.mask], dotted()[~edited.mask])
    within = edited.rgb[edited.mask].astype(int)
    assert within.min() < 40 if left > 70 else np.abs(within - 120).max() <= 2
    assert (SPOTS & edited.mask).any()


def test_relief_between_dots_has_no_dots() -> None:
    """Dots that moved by eight pixels leave no relief: where either picture has one, it is filled."""
    moved = np.roll(dotted(), 8, axis=1)
    raw = touch_edits.relief(moved, dotted())
    filled = touch_edits.between_dots(raw, moved, dotted())
    assert np.abs(raw[40:200, 40:280]).max() == 90
    assert np.abs(filled[40:200, 40:280]).max() < 1
