"""Started while a part presses: a pressed gel learnt as free is noticed and corrected; nothing is scored meanwhile."""

import numpy as np
import pytest
from press_films import PARTS, grains, series

from edge.core.contact.events import (
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceCorrected,
    ReferenceDoubted,
    StartedTouched,
)
from edge.core.contact.reference import Reference, View
from edge.core.contact.sight import measure_light
from edge.core.contact.tracker import ContactTracker

FPS = 18.75
PRESSES = (PressBegan, PressSettled, PressNotSettled, PressEnded)


class Station:
    """A tracker that is shown a part, or the free gel, for some time."""

    def __init__(self, tracker: ContactTracker, part: str, gel: str = "clear") -> None:
        self.tracker, self.views, self.count = tracker, series(part, gel), 0
        self.rng = np.random.default_rng(5)
        self.events: list[object] = []

    def show(self, seconds: float, depth: int) -> None:
        """depth: which of the part's depths."""
        for _ in range(round(seconds * FPS)):
            self.count += 1
            noise = grains()[self.rng.integers(len(grains()))] * np.float32(self.rng.choice((-1, 1)))
            view = np.clip(np.rint(self.views[depth] + noise), 0, 255)
            self.events += self.tracker.feed(view, round(self.count * 1e9 / FPS), self.count)

    def press(self, seconds: float = 0.6) -> None:
        """Down over four depths, held, and up again, then a second of free gel."""
        for depth in (4, 7, 9, 11):
            self.show(0.08, depth)
        self.show(seconds, 12)
        self.show(0.08, 7)
        self.show(1.0, 0)

    def of(self, *kinds: type) -> list[object]:
        return [event for event in self.events if isinstance(event, kinds)]


def free_view(part: str, gel: str = "clear") -> View:
    return series(part, gel)[0]


@pytest.mark.parametrize(
    ("part", "gel"),
    [("PZ3", "clear"), ("ball", "clear"), ("PZ2", "marker"), ("PZ3", "marker"), ("PZ5", "marker")],
)
def test_a_pressed_first_start_recovers_by_itself(part: str, gel: str) -> None:
    """Nothing is known of the gel: the lift is doubted and not counted, and then three presses are three."""
    station = Station(ContactTracker(), part, gel)
    station.show(3.0, 12)
    station.show(1.0, 0)
    assert station.of(*PRESSES) == []
    assert station.of(ReferenceDoubted)
    assert station.of(ReferenceCorrected)
    for _ in range(3):
        station.press()
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [3, 3, 3]
    assert station.tracker.reference is not None
    assert np.abs(station.tracker.reference.view - free_view(part, gel)).mean() < 1.5
    assert station.tracker.light == pytest.approx(measure_light(free_view(part, gel)), rel=0.02)


def test_presses_that_decide_little_decide_together() -> None:
    """A smooth ball over markers hardly adds structure: the lift counts as a press, and within ten it is noticed."""
    station = Station(ContactTracker(), "ball", "marker")
    station.show(3.0, 12)
    station.show(1.0, 0)
    for _ in range(10):
        station.press()
    assert station.of(ReferenceCorrected)
    station.events.clear()
    for _ in range(3):
        station.press()
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [3, 3, 3]


@pytest.mark.parametrize("gel", ["clear", "marker"])
def test_the_bundles_free_gel_shows_a_pressed_first_start(gel: str) -> None:
    """With the picture that the bundle was fitted with, it is noticed before anything is learnt."""
    witness = Reference(free_view("PZ3", gel))
    station = Station(ContactTracker(witness=witness), "PZ3", gel)
    station.show(3.0, 12)
    if gel == "clear":
        assert station.of(StartedTouched)
    station.show(1.0, 0)
    assert station.of(PressSettled) == []
    station.events.clear()
    for _ in range(3):
        station.press()
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [3, 3, 3]


def test_the_free_gel_of_another_unit_is_no_witness() -> None:
    """A bundle from elsewhere: the gel differs all over, so it is learnt as if there were no picture."""
    other = np.ascontiguousarray(free_view("PZ3")[::-1, ::-1])
    station = Station(ContactTracker(witness=Reference(other)), "PZ3")
    station.show(2.0, 0)
    station.press()
    assert station.of(StartedTouched) == []
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [1, 1, 1]


@pytest.mark.parametrize("known", ["no picture", "the bundle's", "one of another size"])
def test_a_stored_picture_that_was_learnt_pressed_is_given_up(known: str) -> None:
    """The last run began pressed and kept that picture: a free start looks touched, and is the free gel, also where the
    bundle's picture of the free gel tells that, or a picture of another size tells nothing."""
    wrong, free = Reference(series("PZ3", "clear")[12]), free_view("PZ3")
    witness = {
        "no picture": None,
        "the bundle's": Reference(free),
        "one of another size": Reference(free[:-8]),
    }
    station = Station(ContactTracker(stored=wrong, witness=witness[known]), "PZ3")
    station.show(2.5, 0)
    assert station.of(PressSettled) == []
    assert station.of(ReferenceCorrected)
    station.press()
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [1, 1, 1]


def test_a_first_press_is_not_taken_for_a_lift() -> None:
    """On a free first start nothing is doubted, whatever the part."""
    for part, gel in (("PZ1", "clear"), ("PZ4", "marker"), ("ball", "marker"), ("soft", "clear")):
        station = Station(ContactTracker(), part, gel)
        station.show(2.0, 0)
        station.press()
        assert station.of(ReferenceDoubted) == []
        assert len(station.of(PressSettled)) == 1


@pytest.mark.parametrize("part", PARTS)
def test_a_slow_first_press_is_counted_where_the_bundles_free_gel_is_known(part: str) -> None:
    """It bends the gel before it touches an area of it, and as long shows no area against the bundle's picture."""
    station = Station(ContactTracker(witness=Reference(free_view(part))), part)
    station.show(2.0, 0)
    for depth in range(13):
        station.show(0.12, depth)
    station.show(1.0, 12)
    station.show(0.08, 7)
    station.show(2.0, 0)
    assert station.of(ReferenceDoubted) == []
    assert [len(station.of(kind)) for kind in (PressBegan, PressSettled, PressEnded)] == [1, 1, 1]
