"""What has changed on the free gel: marks are found; light, shading, small movements and the last imprint are not."""

import cv2
import numpy as np
import pytest

from edge.core.gel_scars.free_change import find_clear_marks, marks

SHAPE = (120, 160)
Y, X = np.mgrid[:120, :160].astype(np.float32)


def gel(seed: int = 0) -> np.ndarray:
    """A smooth gel with the noise of a mean of ten frames."""
    rng = np.random.default_rng(seed)
    clean = np.stack([120 + 0.2 * Y, 130 - 0.1 * X, 110 + 0.1 * X], axis=2)
    return np.asarray(clean + 0.35 * rng.standard_normal((*SHAPE, 3)), np.float32)


def marked(view: np.ndarray, levels: float = 8.0) -> np.ndarray:
    """With a scratch 20 pixels long and two wide."""
    view = view.copy()
    view[60:62, 70:90] -= np.float32(levels)
    return view


def found(first: np.ndarray, now: np.ndarray, left: np.ndarray | None = None) -> np.ndarray:
    known = marks(first, now, left)
    assert known is not None
    return known.places


@pytest.mark.parametrize(
    "now", [gel(2), gel(2) * np.float32(0.8), gel(2) * np.float32(1.2), gel(2) + (12 * X / 160)[..., None]]
)
def test_light_is_no_mark(now: np.ndarray) -> None:
    """Noise, automatic exposure, and a lamp that has become weaker on one side."""
    assert found(gel(1), now).mean() < 0.001


def test_a_scratch_is_found_where_it_is() -> None:
    places = found(gel(1), marked(gel(2)))
    near = np.zeros(SHAPE, bool)
    near[57:65, 67:93] = True

    assert places[60:62, 70:90].mean() > 0.9
    assert (places & ~near).mean() < 0.001


def test_the_change_of_a_scratch_is_signed_and_nothing_elsewhere() -> None:
    """Eight levels darker, in full within the scratch; five pixels away there is none."""
    known = marks(gel(1), marked(gel(2)))
    assert known is not None
    near = np.zeros(SHAPE, bool)
    near[52:70, 62:98] = True

    assert known.change[60:62, 72:88].mean() == pytest.approx(-8, abs=0.5)
    assert np.abs(known.change[~near]).max() < 0.01 or found(gel(1), gel(2)).any()


def test_what_the_last_press_has_left_is_no_mark_and_a_scratch_in_it_is() -> None:
    """A tenth of a ribbed imprint is still there."""
    ribs = np.where((X - 80) ** 2 + (Y - 60) ** 2 < 40**2, 50 * np.sin(Y / 2), 0).astype(np.float32)
    imprint = np.asarray(ribs[..., None] * np.array([1, 0.5, -1]), np.float32)
    rest = np.float32(0.1) * imprint

    assert found(gel(1), gel(2) + rest).mean() > 0.05  # it would be taken for marks
    assert found(gel(1), gel(2) + rest, imprint).mean() < 0.001
    assert found(gel(1), marked(gel(2), 15) + rest, imprint)[60:62, 70:90].mean() > 0.9


def test_a_last_press_that_has_left_nothing_hides_nothing() -> None:
    """Not even noise, as in a recording that holds one picture."""
    assert (
        found(gel(1), marked(gel(2)), np.zeros((*SHAPE, 3), np.float32)) == found(gel(1), marked(gel(2)))
    ).all()


def test_a_hair_is_found_in_what_the_last_press_has_left() -> None:
    """A line one pixel wide of 7 levels, across a rest of 6: what is left behind does not hide it."""
    crests = np.where((X - 80) ** 2 + (Y - 60) ** 2 < 40**2, 80 * np.sin(Y / 5), 0).astype(np.float32)
    imprint = np.asarray(crests[..., None] * np.array([1, 0.2, -0.8]), np.float32)
    now = gel(2) + np.float32(0.07) * imprint
    now[50:70, 80] += np.float32(7)
    places = found(gel(1), now, imprint)

    assert places[50:70, 79:82].any(axis=1).mean() > 0.8
    assert places.mean() < 0.005


@pytest.mark.parametrize(("right", "down"), [(0.2, 0.0), (0.0, 0.2)])
def test_dots_that_move_a_little_are_no_marks(right: float, down: float) -> None:
    """A marker gel creeps by a hundredth of a millimetre between presses, here by twice that, either way."""
    dots = np.ones(SHAPE, np.float32)
    for x in range(12, 160, 20):
        for y in range(10, 120, 20):
            cv2.circle(dots, (x, y), 3, 0.3, -1, cv2.LINE_AA)
    soft = cv2.GaussianBlur(dots, (0, 0), 1.0)
    moved = cv2.warpAffine(
        soft, np.array([[1, 0, right], [0, 1, down]]), (160, 120), borderMode=cv2.BORDER_REPLICATE
    )

    assert found(gel(1) * soft[..., None], gel(2) * moved[..., None]).mean() < 0.002


def test_a_gel_that_has_changed_all_over_has_no_known_marks() -> None:
    """The camera was moved, or another gel is mounted: no place explains anything."""
    other = gel(2) + np.asarray(20 * np.sin(X / 2)[..., None] * np.sin(Y / 2)[..., None], np.float32)

    assert marks(gel(1), other) is None


def spot(levels: float, sigma: float, seed: int = 2) -> np.ndarray:
    """A gel of one frame's noise with a round spot."""
    around = np.exp(-((X - 80) ** 2 + (Y - 60) ** 2) / (2 * sigma**2))
    noise = np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    return np.asarray(gel(seed) + noise + levels * around[..., None], np.float32)


@pytest.mark.parametrize(
    ("now", "is_clear"),
    [
        (spot(0, 1), False),
        (spot(20, 1.5), True),
        (spot(-20, 1.5), True),
        (spot(10, 6), False),
        (spot(3, 1.5), False),
    ],
    ids=["nothing", "a grain", "a pit", "a stain of worn coat", "a faint grain"],
)
def test_what_is_plain_to_see_in_one_frame_is_a_clear_mark(now: np.ndarray, is_clear: bool) -> None:
    clear = find_clear_marks(gel(1), now)

    assert clear is not None
    assert clear.any() == is_clear
    assert not clear[:50].any()


@pytest.mark.parametrize(("slope", "is_clear"), [(8, True), (10, False)])
def test_a_grain_is_clear_where_a_gel_that_moves_would_change_less(slope: int, is_clear: bool) -> None:
    """A quarter of a pixel of such slopes, levels a pixel, is a doubt of 2 or 2.5. Three doubts and the 2.2 levels of a
    clear mark are 8.2 or 9.7; what this grain has lies between them."""
    ramp = np.asarray(slope * X[..., None], np.float32)
    clear = find_clear_marks(gel(1) + ramp, spot(20, 1.5) + ramp)

    assert clear is not None
    assert clear[55:65, 75:85].any() == is_clear


def test_a_grain_that_lay_there_first_and_is_gone_is_no_clear_mark() -> None:
    """A gel is not clean when it is mounted; wiped, it shows less."""
    clear, known = find_clear_marks(spot(20, 1.5), gel(3)), marks(spot(20, 1.5), gel(3))

    assert clear is not None
    assert known is not None
    assert (clear.any(), known.places[55:65, 75:85].any()) == (False, True)


def test_of_a_moment_after_a_release_what_is_left_may_be_twice_as_much() -> None:
    """A deep place recovers otherwise than a shallow one: a fifth of the imprint where a tenth is left on the whole."""
    ribs = np.where((X - 80) ** 2 + (Y - 60) ** 2 < 40**2, 50 * np.sin(Y / 2), 0).astype(np.float32)
    imprint = np.asarray(ribs[..., None] * np.array([1, 0.5, -1]), np.float32)
    rest = np.where((X[..., None] - 80) ** 2 + (Y[..., None] - 60) ** 2 < 6**2, 0.19, 0.1) * imprint
    now = np.asarray(gel(2) + rest, np.float32)
    later, fresh = marks(gel(1), now, imprint), marks(gel(1), now, imprint, is_fresh=True)

    assert later is not None
    assert fresh is not None
    assert (later.places.any(), fresh.places.mean() < 0.001) == (True, True)


def test_pictures_of_two_sizes_are_refused() -> None:
    """They show nothing of each other."""
    with pytest.raises(ValueError, match="one shape"):
        marks(gel(1), gel(2)[:60])
