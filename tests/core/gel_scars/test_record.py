"""The decaying record of a gel: what it counts, what it masks, what it forgets, and that it never grows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.gel_scars.record import PLANES, ScarRecord

SHAPE = (12, 16)
NOWHERE = np.zeros(SHAPE, bool)
EVERYWHERE = np.ones(SHAPE, bool)


def spot(row: int = 5, column: int = 7) -> np.ndarray:
    places = NOWHERE.copy()
    places[row : row + 2, column : column + 2] = True
    return places


def pressed(record: ScarRecord, times: int, exceeds: np.ndarray = NOWHERE) -> ScarRecord:
    for _ in range(times):
        record = record.after(exceeds, EVERYWHERE, NOWHERE, None)
    return record


def test_a_place_that_exceeds_in_every_press_has_rate_one() -> None:
    """Three presses count a little less than three: older ones fade."""
    repeats = pressed(ScarRecord.empty(SHAPE), 3, spot()).repeats(spot())

    assert repeats.rate == 1
    assert 2.9 < repeats.hits < 3


def test_three_presses_of_late_are_often() -> None:
    """More than 2.7 and less than 3.5, after fading; quiet presses do not count."""
    record = pressed(pressed(ScarRecord.empty(SHAPE), 9), 3, spot())

    assert np.array_equal(record.often(2.7), spot())
    assert not record.often(3.5).any()


def test_the_part_s_places_are_kept_as_their_spread() -> None:
    """Presses at x = -1, 0 and 1 mm: a standard deviation of sqrt(2/3) mm, but for the fading."""
    record = ScarRecord.empty(SHAPE)
    for x in (-1.0, 0.0, 1.0):
        record = record.after(spot(), EVERYWHERE, NOWHERE, (x, 5.0))

    assert record.repeats(spot()).spread_mm == pytest.approx((2 / 3) ** 0.5, abs=0.01)


def test_a_part_at_one_place_has_no_spread() -> None:
    """Whatever that place is: no rounding makes a movement of it."""
    record = ScarRecord.empty(SHAPE)
    for _ in range(50):
        record = record.after(spot(), EVERYWHERE, NOWHERE, (7.3, -6.1))

    assert record.repeats(spot()).spread_mm < 0.02


def test_a_mask_is_forgotten_after_eighteen_quiet_presses() -> None:
    """A hair that was wiped off: the place is judged again; until then it is not."""
    record = ScarRecord.empty(SHAPE).after(spot(), EVERYWHERE, spot(), None)

    assert np.array_equal(pressed(record, 17).masked, spot())
    assert not pressed(record, 18).masked.any()


def test_a_mask_stays_as_long_as_its_place_exceeds() -> None:
    """Or is not pressed at all: what is not seen says nothing."""
    record = ScarRecord.empty(SHAPE).after(spot(), EVERYWHERE, spot(), None)
    unseen = record
    for _ in range(100):
        unseen = unseen.after(NOWHERE, NOWHERE, NOWHERE, None)

    assert np.array_equal(pressed(record, 100, spot()).masked, spot())
    assert np.array_equal(unseen.masked, spot())


def test_one_press_that_exceeds_begins_the_count_of_quiet_ones_again() -> None:
    """Twice seventeen quiet presses with one between them forget nothing."""
    record = ScarRecord.empty(SHAPE).after(spot(), EVERYWHERE, spot(), None)

    assert np.array_equal(pressed(pressed(pressed(record, 17), 1, spot()), 17).masked, spot())


def test_an_unknown_place_has_no_repeats() -> None:
    record = pressed(ScarRecord.empty(SHAPE), 5)

    assert (record.repeats(spot()).hits, record.repeats(NOWHERE).hits) == (0, 0)


@pytest.mark.parametrize(
    "planes",
    [
        np.zeros((PLANES, 3, 4), np.float64),
        np.zeros((PLANES + 1, 3, 4), np.float32),
        np.full((PLANES, 3, 4), np.nan, np.float32),
        np.full((PLANES, 3, 4), -1, np.float32),
    ],
)
def test_what_is_no_record_is_refused(planes: np.ndarray) -> None:
    """A damaged file must not decide what is judged."""
    with pytest.raises(ValueError, match="a record"):
        ScarRecord(planes)  # type: ignore[arg-type]


def random_masks(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    exceeds, shown, scars = rng.random((3, *SHAPE)) < rng.random((3, 1, 1))
    return exceeds, shown, scars


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 12))
def test_any_presses_leave_a_record_of_the_same_size(seed: int, presses: int) -> None:
    """Numbers stay finite, rates between 0 and 1, and only what was ever a scar is masked."""
    rng, record, ever = np.random.default_rng(seed), ScarRecord.empty(SHAPE), NOWHERE
    for _ in range(presses):
        exceeds, shown, scars = random_masks(rng)
        place = None if rng.random() < 0.5 else (float(rng.uniform(-9, 9)), float(rng.uniform(-9, 9)))
        record = record.after(exceeds & shown, shown, scars, place)
        ever = ever | scars
        assert record.planes.nbytes == PLANES * 12 * 16 * 4
        assert not (record.masked & ~ever).any()
        assert 0 <= record.repeats(EVERYWHERE).rate <= 1


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_gel_has_the_mirrored_record(seed: int) -> None:
    """No place of the gel is another's neighbour."""
    exceeds, shown, scars = random_masks(np.random.default_rng(seed))
    record = ScarRecord.empty(SHAPE).after(exceeds, shown, scars, (1.0, 2.0))
    mirrored = ScarRecord.empty(SHAPE).after(exceeds[:, ::-1], shown[:, ::-1], scars[:, ::-1], (1.0, 2.0))

    assert np.array_equal(record.planes[..., ::-1], mirrored.planes)
