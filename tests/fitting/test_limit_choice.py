"""Which limit a fit chooses, on maps whose differences between presses are known."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.limits.limit_choice import WORTH, Evidence, choose_limit
from calibration.fitting.limits.map_limit import PLAIN, SURROUNDINGS, relate

PX = 4.0
SIDE, PRESSES, EDITS = 48, 24, 24
PLACE = 4 + 8 * np.arange(6)


def scored(maps: np.ndarray) -> ScoredPresses:
    return ScoredPresses(maps.astype(np.float32), maps.max(axis=(1, 2)).astype(np.float64))


def noise(count: int, seed: int) -> np.ndarray:
    return 1 + 0.02 * np.random.default_rng(seed).random((count, SIDE, SIDE))


def evidence(background: np.ndarray, height: float = 0.3) -> Evidence:
    """Nominal presses with this background, and damage of 3x3 pixels of this height on each of them."""
    sound, near = background + noise(PRESSES, 1), np.zeros((EDITS, SIDE, SIDE), np.bool_)
    for number in range(EDITS):
        row, column = PLACE[number % 6], PLACE[number // 6 % 6]
        near[number, row - 1 : row + 2, column - 1 : column + 2] = True
    edited = sound + height * near
    return Evidence(
        HeldOut(scored(sound), scored(edited)),
        scored(0.9 * sound),
        None,
        DamagedPresses(np.zeros((EDITS, SIDE, SIDE, 3), np.uint8), np.arange(EDITS), near),
        [np.arange(k, PRESSES, 4) for k in range(4)],
        (None,) * PRESSES,
        0.05,
        PX,
    )


def even(spread: float) -> np.ndarray:
    """Each press lies higher or lower as a whole."""
    return np.asarray(np.random.default_rng(2).normal(3, spread, (PRESSES, 1, 1)))


def unlike() -> np.ndarray:
    """One press is several times as high as another, and uneven in proportion."""
    rng = np.random.default_rng(2)
    return rng.lognormal(0, 0.7, (PRESSES, 1, 1)) * rng.uniform(0, 2, (PRESSES, SIDE, SIDE))


def test_presses_of_unlike_level_are_compared_with_their_surroundings() -> None:
    """One limit for all places is that of the highest press, under which damage on others hides."""
    choice = choose_limit(evidence(unlike(), 5.0))
    assert choice.kind == SURROUNDINGS
    assert choice.found[choice.kind] > choice.found["plain"] + 0.5
    assert "24 small pieces" in choice.why


def stepped() -> np.ndarray:
    """One half is higher, and each press has a spike in the other one that is lower than that."""
    found = np.zeros((PRESSES, SIDE, SIDE))
    found[:, :, SIDE // 2 :] = 3
    found[np.arange(PRESSES), np.arange(PRESSES) + 8, 1] = 2.5
    return found


@pytest.mark.parametrize(
    ("background", "height", "kind"),
    [(even(0.001), 9.0, SURROUNDINGS), (even(0.001), 0.0, PLAIN), (stepped(), 0.3, PLAIN)],
    ids=["both find all", "neither finds anything", "the plain one finds more"],
)
def test_the_surroundings_are_taken_unless_the_plain_limit_finds_more(
    background: np.ndarray, height: float, kind: str
) -> None:
    """Their maps show damage better at equal finds; where nothing is found there is no reason to leave raw scores."""
    choice = choose_limit(evidence(background, height))
    assert choice.kind == kind
    assert (choice.other is None) == (kind == PLAIN)


def test_the_published_limit_is_one() -> None:
    """As many nominal presses lie above 1 as above the limit that was found, and the promise is the same."""
    chosen = choose_limit(evidence(unlike(), 5.0)).other
    assert chosen is not None
    assert chosen.threshold.value == 1
    assert chosen.threshold.n == PRESSES
    above = int((chosen.scores > 1 + 1e-6).sum())
    assert chosen.threshold.by_press is not None
    assert chosen.threshold.by_press.alarms == above <= 1


def test_an_alarm_of_the_guard_is_counted() -> None:
    """One press has a spike, and another lies so high as a whole that the guard fails it: two alarms, and pieces, of
    what is compared, one of the contrasts."""
    background = np.zeros((PRESSES, SIDE, SIDE))
    background[0] = 5
    background[1, 2, 2] = 1
    pieces = (*(f"piece {k}" for k in range(PRESSES - 1)), f"piece {PRESSES - 2}")
    found = replace(evidence(background, 9.0), alpha=0.1, specimens=pieces)
    chosen = choose_limit(found).other
    assert chosen is not None
    assert sum(score > 1 for score in chosen.threshold.nominal_scores) == 2
    assert chosen.threshold.by_press is not None
    assert chosen.threshold.by_piece is not None
    assert (chosen.threshold.by_press.alarms, chosen.threshold.by_piece.alarms) == (2, 2)


def test_new_sound_presses_fail_no_more_than_promised() -> None:
    """Over 20 bundles of presses that differ as wholes at most 5 % of new presses fail."""
    rates = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        maps = 1 + 0.02 * rng.random((PRESSES + 40, SIDE, SIDE)) + rng.random((PRESSES + 40, 1, 1))
        sound, found = scored(maps[:PRESSES]), evidence(even(0.0))
        edited = scored(sound.maps + 0.4 * found.damage.masks)
        found = replace(found, held_out=HeldOut(sound, edited), known=scored(0.5 * sound.maps))
        chosen = choose_limit(found).other
        assert chosen is not None
        rates.append(np.mean(relate(chosen.limit, maps[PRESSES:]).max(axis=(1, 2)) > 1))
    assert 0 < np.mean(rates) <= 0.05


def test_a_black_frame_goes_on_failing() -> None:
    """A limit by which a black frame passes is not chosen, where nothing else refuses the frame."""
    found = evidence(unlike(), 5.0)
    dark = scored(np.full((1, SIDE, SIDE), 1.05 * found.plain.value))
    bright = scored(np.full((1, SIDE, SIDE), 9e3))
    assert choose_limit(replace(found, black=dark)).kind != SURROUNDINGS
    assert choose_limit(replace(found, black=bright)).kind == SURROUNDINGS


def test_maps_below_zero_in_the_mean_keep_the_plain_limit() -> None:
    """By such a mean nothing can be divided."""
    found = evidence(unlike(), 5.0)
    low, damaged, known = (
        scored(one.maps - 3) for one in (found.held_out.sound, found.held_out.edited, found.known)
    )
    choice = choose_limit(replace(found, held_out=HeldOut(low, damaged), known=known))
    assert low.maps.mean() < 0 < low.scores.max()
    assert choice.found.keys() == {PLAIN}


def test_a_score_that_is_no_maximum_keeps_its_limit() -> None:
    """The map says nothing of such a score."""
    found = evidence(unlike(), 5.0)
    sound = ScoredPresses(found.held_out.sound.maps, found.held_out.sound.scores + 1)
    choice = choose_limit(replace(found, held_out=HeldOut(sound, found.held_out.edited)))
    assert choice.kind == PLAIN
    assert "not the highest value" in choice.why


def test_the_plain_limit_has_to_find_clearly_more() -> None:
    """One piece of damage in 24 is found by luck."""
    found = evidence(even(0.0))
    wide = found.held_out.sound.maps.copy()
    wide[1:] += found.damage.masks[1:]
    wide[0] += 0.5
    near = found.damage.masks.copy()
    edited = replace(found.damage, masks=near)
    choice = choose_limit(replace(found, held_out=HeldOut(found.held_out.sound, scored(wide)), damage=edited))
    assert 0 <= choice.found[PLAIN] - choice.found[SURROUNDINGS] < WORTH
    assert choice.kind == SURROUNDINGS


def test_places_that_no_press_shows_change_no_limit() -> None:
    """What the gateway fills in where a press shows nothing counts for no score, whatever it is."""
    found = evidence(even(0.0))
    seen = np.ones((PRESSES, SIDE, SIDE), np.bool_)
    seen[::3, :, :9] = False
    sound, known = (
        replace(one, maps=np.where(seen, one.maps, 99).astype(np.float32), seen=seen)
        for one in (found.held_out.sound, found.known)
    )
    filled = replace(found, held_out=HeldOut(sound, found.held_out.edited), known=known)
    assert choose_limit(filled).found[PLAIN] == choose_limit(found).found[PLAIN] == 1


def test_what_is_found_is_said_by_size() -> None:
    """The largest size of each kind."""
    found = evidence(unlike(), 5.0)
    names = tuple(
        f"{kind} of {mm} mm" for kind in ("dent", "bump") for mm in (0.1, 0.4) for _ in range(EDITS // 4)
    )
    found = replace(found, damage=replace(found.damage, names=names))
    counted = found.count_found(choose_limit(found))
    assert (counted.found, counted.count) == (EDITS, EDITS)
    assert counted.why == "dent of 0.4 mm: 6 of 6, bump of 0.4 mm: 6 of 6"
