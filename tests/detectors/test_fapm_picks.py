"""Which nominal rows FAPM keeps: those of the definition; rounding is no distance."""

import numpy as np

from plugins.detectors.fapm.prototypes import cell_layout, choose_prototypes, pick


def test_rows_are_picked_as_defined() -> None:
    """Each pick is the farthest row from the picks before it, and distances are those of float64."""
    x = np.random.default_rng(0).normal(0, 3, (800, 6)).astype(np.float32)
    chosen, nearest, apart = pick(x, 300, 11, s=4)
    squared = np.square(x.astype(np.float64)[:, None] - x[chosen]).sum(axis=2)
    before = np.minimum.accumulate(squared, axis=1)
    assert chosen[0] == 11
    np.testing.assert_allclose(before[chosen[1:], np.arange(299)], before[:, :-1].max(axis=0), rtol=1e-4)
    np.testing.assert_allclose(nearest, before[:, -1], atol=1e-3)
    squared[np.arange(800)[:, None] // 4 == chosen // 4] = np.inf
    np.testing.assert_allclose(apart, squared.min(axis=1), atol=1e-3)


def test_every_row_is_picked_once_where_many_are_equally_far() -> None:
    """Corners of a cube, many times each: the lowest row among equals, and at last all rows."""
    x = np.random.default_rng(0).integers(0, 2, (520, 3)).astype(np.float32)
    chosen = pick(x, 520, 7, s=2)
    assert sorted(chosen.picks) == list(range(520))
    assert chosen.picks[1] == np.flatnonzero((x != x[7]).all(axis=1))[0]
    assert not chosen.nearest.any()


def test_a_repeated_row_is_at_no_distance() -> None:
    """Rows equal to a pick are at distance 0 from it, not at the rounding of a product, however few rows there are."""
    two = np.random.default_rng(0).normal(50, 20, (2, 64, 32)).astype(np.float32)
    rows, places = np.concatenate([two] * 6), cell_layout((8, 8), 4, is_shared=True)

    every_kind_once, every_row = (choose_prototypes(rows, places, (k, k), 0.75, 0.3) for k in (64, 192))
    assert every_kind_once.is_far.all()
    assert not every_row.apart.any()
