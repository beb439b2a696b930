"""A sensor whose frames show nothing is noticed within two seconds."""

from collections.abc import Callable

import numpy as np
import pytest

from edge.core.contact.reference import View
from edge.core.contact.sight import Sight, measure_light

PERIOD_NS = 53_333_333


def free_gel(number: int) -> View:
    """A gel with a slope of light and the noise of a sensor."""
    rng = np.random.default_rng(number)
    slope = np.linspace(80, 130, 160, dtype=np.float32)[None, :, None]
    return np.asarray(slope + rng.normal(0, 1, (120, 160, 3)), np.float32)


FROZEN = free_gel(-1 + 2**31)
BLIND: dict[str, Callable[[int], View]] = {
    "black": lambda n: free_gel(n) * 0.02,
    "white": lambda n: np.minimum(free_gel(n) + 160, 255),
    "of one colour": lambda n: free_gel(n) * 0.05 + 100,
    "has not changed": lambda n: FROZEN,
}


@pytest.mark.parametrize("fault", BLIND)
def test_a_sensor_that_shows_nothing_is_lost_after_two_seconds(fault: str) -> None:
    """Not before, with the reason; it is seen again with its first sound frame."""
    sight = Sight()
    for number in range(20):
        assert sight.see(free_gel(number), number * PERIOD_NS)
    lost = []
    for number in range(20, 70):
        sight.see(BLIND[fault](number), number * PERIOD_NS)
        lost.append(sight.lost)
    first = next(n for n, reason in enumerate(lost, 20) if reason is not None)
    assert 2.0 <= (first - 19) * PERIOD_NS / 1e9 <= 2.2
    assert fault in str(lost[-1])
    assert sight.since_ns in (19 * PERIOD_NS, 20 * PERIOD_NS)
    assert sight.see(free_gel(70), 70 * PERIOD_NS)
    assert sight.lost is None


DIMMED: dict[str, Callable[[int], View]] = {
    "of the light": lambda n: free_gel(n) * 0.4,
    "of the contrast": lambda n: free_gel(n) * 0.3 + 75,
}


@pytest.mark.parametrize("fault", DIMMED)
def test_less_than_half_of_the_free_gels_light_or_contrast_is_blindness(fault: str) -> None:
    """A press hardly differs from a gel that has become so dark. Another gel or sensor may be as dark."""
    sight, other, usual = Sight(), Sight(), measure_light(free_gel(0))
    assert sight.see(free_gel(0), 0, usual)
    for number in range(1, 42):
        assert not sight.see(DIMMED[fault](number), number * PERIOD_NS, usual)
        assert other.see(DIMMED[fault](number), number * PERIOD_NS)
    assert fault in str(sight.lost)


def test_a_picture_that_comes_and_goes_is_lost_though_it_comes_back_in_time() -> None:
    """A light that is out for a second of two. It is seen again when it has stayed for eight seconds."""
    sight, lost = Sight(), []
    for number in range(38 * 8):
        sight.see((free_gel if number % 38 < 19 else BLIND["black"])(number), number * PERIOD_NS)
        lost.append(sight.lost)
    first = next(number for number, fault in enumerate(lost) if fault is not None)
    assert 8.0 < first * PERIOD_NS / 1e9 < 12.0
    assert all("black" in str(fault) for fault in lost[first:])
    back = [sight.see(free_gel(n), n * PERIOD_NS) and sight.lost is None for n in range(38 * 8, 38 * 13)]
    assert 7.0 < back.index(True) * PERIOD_NS / 1e9 < 9.0


def test_one_long_time_without_sight_is_no_coming_and_going() -> None:
    """With the next sound frame it is over, and so are single broken frames."""
    sight = Sight()
    for number in range(400):
        is_broken = 20 <= number < 200 or number % 2
        sight.see((BLIND["black"] if is_broken else free_gel)(number), number * PERIOD_NS)
        assert sight.lost is None or number < 200
    assert not sight.comes_and_goes


def test_a_driver_that_goes_round_in_its_buffers_shows_nothing() -> None:
    """Four frames in turn are four pictures of long ago."""
    sight = Sight()
    for number in range(60):
        sight.see(free_gel(number % 4), number * PERIOD_NS)
    assert sight.lost == "its picture has not changed"


def test_a_pause_of_the_stream_is_not_blindness() -> None:
    """The first black frames after it are a camera that starts."""
    sight = Sight()
    sight.see(free_gel(0), 0)
    sight.resume(10**10)
    for number in range(10):
        sight.see(BLIND["black"](number), 10**10 + number * PERIOD_NS)
    assert sight.lost is None


def test_a_sensor_that_never_showed_its_gel_is_lost_too() -> None:
    """Its time without sight begins with its first frame."""
    sight = Sight()
    for number in range(60):
        sight.see(BLIND["black"](number), number * PERIOD_NS)
    assert "black" in str(sight.lost)
    assert sight.since_ns == 0
