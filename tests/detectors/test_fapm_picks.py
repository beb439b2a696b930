"""Which nominal rows FAPM keeps: the same by fronts, by pairs and as defined; rounding is no distance."""

import numpy as np
import pytest

from plugins.detectors.fapm import picks
from plugins.detectors.fapm.picks import pick
from plugins.detectors.fapm.prototypes import cell_layout, choose_prototypes


def test_many_rows_are_picked_as_defined() -> None:
    """Each pick is the farthest row from the picks before it, and distances are those of float64, in two groups of 800
    rows, where no front holds all picks."""
    x = np.random.default_rng(0).normal(0, 3, (2, 800, 6)).astype(np.float32)
    found = pick(x, 300, 11, s=4)
    assert picks.MANY_ROWS < 800
    for rows, chosen, nearest, apart in zip(x.astype(np.float64), *found, strict=True):
        squared = np.square(rows[:, None] - rows[chosen]).sum(axis=2)
        before = np.minimum.accumulate(squared, axis=1)
        farthest = before[:, :-1].max(axis=0)
        assert chosen[0] == 11
        np.testing.assert_allclose(before[chosen[1:], np.arange(299)], farthest, rtol=1e-4)
        np.testing.assert_allclose(nearest, before[:, -1], atol=1e-3)
        squared[np.arange(800)[:, None] // 4 == chosen // 4] = np.inf
        np.testing.assert_allclose(apart, squared.min(axis=1), atol=1e-3)


def test_every_row_is_picked_once_where_many_are_equally_far() -> None:
    """Corners of a cube, many times each: by fronts as by pairs, the lowest row among equals, and at last all rows."""
    x = np.random.default_rng(0).integers(0, 2, (1, 520, 3)).astype(np.float32)
    by_fronts = pick(x, 520, 7, s=2)
    small = pick(x[:, :510], 510, 7, s=2)
    assert sorted(by_fronts.picks[0]) == list(range(520))
    assert by_fronts.picks[0, :8].tolist() == small.picks[0, :8].tolist()
    assert not by_fronts.nearest.any()


@pytest.mark.parametrize("n", [3, 40])
def test_few_and_many_rows_choose_the_same_prototypes(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Picking in fronts finds what comparing all pairs finds; integers of mean 0, so that equals stay
    equal."""
    half = np.random.default_rng(0).integers(-8, 8, (n, 64, 4)).astype(np.float32)
    rows = np.concatenate([half, -half])
    places = cell_layout((8, 8), 4, is_shared=True)
    found = []
    for many in (1, 10_000):
        monkeypatch.setattr(picks, "MANY_ROWS", many)
        found.append(choose_prototypes(rows, places, (4, 8), 0.75, 0.3))

    by_picks, by_pairs = found
    assert np.array_equal(by_picks.is_far, by_pairs.is_far)
    assert by_picks.is_far.sum() == 1
    for name in ("mean", "rows", "apart"):
        assert np.array_equal(getattr(by_picks, name), getattr(by_pairs, name)), name


@pytest.mark.parametrize("many", [1, 10_000])
def test_a_repeated_row_is_at_no_distance(many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows equal to a pick are at distance 0 from it, not at the rounding of a product, however few rows there are."""
    monkeypatch.setattr(picks, "MANY_ROWS", many)
    two = np.random.default_rng(0).normal(50, 20, (2, 64, 32)).astype(np.float32)
    rows, places = np.concatenate([two] * 6), cell_layout((8, 8), 4, is_shared=True)

    every_kind_once, every_row = (choose_prototypes(rows, places, (k, k), 0.75, 0.3) for k in (64, 192))
    assert every_kind_once.is_far.all()
    assert not every_row.apart.any()
