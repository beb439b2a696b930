"""Is the right frame of each press taken? Films of known depth: slow ramps, short holds, slips, a hand, any frame rate.

    pytest -m bench -s tests/bench/test_right_frame.py

As a station does, it knows the free gel of the fit, whose light was another one. Settings were chosen on films 1000 to
1023, and films 0 to 169 judge them. `FILMS` and `FREE_FRAMES` shorten it.
"""

import os

import pytest
from press_films import HEAD, Outcome, free_film, judged, random_film, series, table

from edge.core.contact.reference import Reference
from edge.core.contact.settled_frame import Window
from edge.core.contact.tracker import ContactTracker

FILMS = int(os.environ.get("FILMS", "170"))
FREE_FRAMES = int(os.environ.get("FREE_FRAMES", "100000"))


@pytest.mark.bench
def test_the_right_frame_of_each_press() -> None:
    """Depth at the chosen frame: .95 of the press's largest in the median, 2 % below .8; none lost, none twice."""
    outcomes, invented = _follow_films()
    for by in (
        lambda one: f"{one.film.fps:g} frames/s",
        lambda one: one.press.kind,
        lambda one: f"gel {one.film.gel}",
        lambda one: f"light {one.film.light}",
        lambda one: one.film.part,
        lambda one: "soft part" if one.film.part == "soft" else "hard parts",
        _tell_hold,
    ):
        print("\n" + HEAD, *table(outcomes, invented, by), sep="\n")
    shares = sorted(one.share for one in outcomes if one.share is not None)
    assert shares[len(shares) // 2] >= 0.95
    assert sum(share < 0.8 for share in shares) <= 0.02 * len(shares)
    assert [one for one in outcomes if one.began != 1] == []
    assert invented == 0


@pytest.mark.bench
def test_what_the_peak_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same films, where no press that never rests is taken at its peak; the table by hold."""
    monkeypatch.setattr(Window, "choose_peak", lambda *_: None)
    outcomes, invented = _follow_films()
    print("\n" + HEAD, *table(outcomes, invented, _tell_hold), sep="\n")


def _follow_films() -> tuple[list[Outcome], int]:
    """Follow the films as a station does; what became of each press, and how many were invented."""
    outcomes: list[Outcome] = []
    invented = 0
    for seed in range(FILMS):
        film = random_film(seed)
        bundles = Reference(series(film.part, film.gel)[0])
        found, more, _ = judged(film, ContactTracker(witness=bundles))
        outcomes += found
        invented += more
    return outcomes, invented


def _tell_hold(one: Outcome) -> str:
    return "held 0.5 s and more" if one.press.hold_s >= 0.5 else "held under 0.5 s"


@pytest.mark.bench
def test_no_press_is_invented() -> None:
    """The free gel with noise, a wandering exposure and another light that comes on: nothing is counted."""
    frames = invented = seed = 0
    while frames < FREE_FRAMES:
        _, found, shown = judged(free_film(10_000 + seed, 4000), ContactTracker())
        frames, invented, seed = frames + shown, invented + found, seed + 1
    print(f"\n{frames} frames of the free gel, {invented} presses")
    assert invented == 0
