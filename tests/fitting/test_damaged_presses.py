"""Small damage that is put into nominal presses to compare trunks: where it lies, and that it shows."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, dome_presses

from calibration.fitting.damage.damaged_presses import add_pieces, damage_presses
from calibration.fitting.presses.nominal_presses import NominalPresses


@pytest.fixture(scope="module")
def presses() -> NominalPresses:
    """Three presses of a dome."""
    return dome_presses(3)


def test_damage_changes_the_picture_where_its_mask_says(presses: NominalPresses) -> None:
    """Both kinds: inside the mask a press differs from its own nominal picture, and less outside."""
    found = damage_presses(presses, PROFILE, REGION, seed=0)
    assert list(found) == ["rendered damage", "pieces of relief"]
    for damaged in found.values():
        changed = np.abs(damaged.frames.astype(int) - presses.frames[damaged.press]).max(axis=3)
        assert (changed.max(axis=(1, 2)) >= 8).all()
        inside = [change[mask].mean() for change, mask in zip(changed, damaged.masks, strict=True)]
        outside = [change[~mask].mean() for change, mask in zip(changed, damaged.masks, strict=True)]
        assert (np.array(inside) > 2 * np.array(outside)).all()


def test_a_piece_is_of_another_press_and_small(presses: NominalPresses) -> None:
    """The mask of a piece is at most one and a half millimetres wide, and every press has some."""
    damaged = add_pieces(presses, PROFILE.pixels_per_mm, np.random.default_rng(0), 12)
    assert set(damaged.press) == {0, 1, 2}
    for mask in damaged.masks:
        rows, columns = np.nonzero(mask)
        assert max(np.ptp(rows), np.ptp(columns)) < 1.5 * PROFILE.pixels_per_mm


def test_a_press_gives_no_piece_to_itself(presses: NominalPresses) -> None:
    """Nothing comes of one press, nor of two of which the other is flat."""
    assert presses.no_contact is not None
    flat = replace(presses.spread(2), frames=np.stack([presses.frames[0], presses.no_contact[0]]))
    for few in (presses.spread(1), flat):
        assert len(add_pieces(few, PROFILE.pixels_per_mm, np.random.default_rng(0), 12)) == 0


def test_a_seed_gives_the_same_damage(presses: NominalPresses) -> None:
    """And another seed other damage."""
    first, again, other = (
        add_pieces(presses, PROFILE.pixels_per_mm, np.random.default_rng(seed), 4) for seed in (1, 1, 2)
    )
    assert np.array_equal(first.frames, again.frames)
    assert not np.array_equal(first.masks, other.masks)


def test_nothing_is_put_into_presses_without_relief(presses: NominalPresses) -> None:
    """Where every press is the free gel, and where there is no picture of it."""
    assert presses.no_contact is not None
    flat = replace(presses, frames=np.repeat(presses.no_contact[:1], 3, axis=0))
    assert damage_presses(flat, PROFILE, REGION, seed=0) == {}
    assert damage_presses(replace(presses, no_contact=None), PROFILE, REGION, seed=0) == {}
